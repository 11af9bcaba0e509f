"""Standard output and standard error that may be closed, full, or without a reader.

Text that cannot be written is discarded; the command's work and exit status are unaffected. A command whose result goes
to standard output writes it within `strict_output`, and ends if that fails.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from collections.abc import Iterator
from typing import Any

LOST = (errno.EPIPE, errno.ENOSPC, errno.EBADF, errno.EIO, errno.EDQUOT)
"""Errors of the output itself, not of the text."""
_STREAMS = (("stdin", "r"), ("stdout", "w"), ("stderr", "w"))


class _Outlet(io.FileIO):
    """File descriptor whose write errors in `LOST` are ignored unless `strict`; `error` is the last one."""

    error: OSError | None = None
    strict = False

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data) or 0
        except OSError as error:
            if error.errno not in LOST:
                raise
            self.error = error
            if self.strict:
                raise
            return len(data)


def make_tolerant() -> None:
    """Open closed standard streams, and make output that cannot be written be discarded.

    Replaced streams, as in tests, are left unchanged.
    """
    for descriptor, (name, mode) in enumerate(_STREAMS):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # uses the lowest free descriptor
        stream = getattr(sys, name)
        if stream is not getattr(sys, f"__{name}__"):
            continue
        if mode == "r":
            sys.stdin = stream or open(descriptor, encoding="utf-8", closefd=False)  # noqa: SIM115  # while it runs
        elif stream is None or isinstance(stream, io.TextIOWrapper):
            setattr(sys, name, _tolerant(descriptor, stream))


def _tolerant(descriptor: int, stream: io.TextIOWrapper | None) -> io.TextIOWrapper:
    """Return a stream with the settings of `stream`; None: of a closed one."""
    raw = io.BufferedWriter(_Outlet(descriptor, "w", closefd=False))
    if stream is None:
        return io.TextIOWrapper(raw, "utf-8", "replace")
    stream.flush()
    lines, through = stream.line_buffering, stream.write_through
    return io.TextIOWrapper(raw, stream.encoding, "replace", line_buffering=lines, write_through=through)


def _raw(stream: Any) -> Any:
    return getattr(getattr(stream, "buffer", None), "raw", None)


@contextlib.contextmanager
def strict_output() -> Iterator[None]:
    """Context in which standard output raises OSError if it cannot be written; it is flushed at the end."""
    raw = _raw(sys.stdout)
    if not isinstance(raw, _Outlet):
        yield
        sys.stdout.flush()
        return
    raw.strict = True
    try:
        yield
        sys.stdout.flush()
    finally:
        raw.strict = False


def output_error() -> str:
    """Return why text on standard output was lost; empty if nothing was, or if the reader has closed it."""
    sys.stdout.flush()
    error = getattr(_raw(sys.stdout), "error", None)
    return "" if error is None or error.errno == errno.EPIPE else str(error.strerror)
