"""Standard output and standard error that may be closed, full, or read by nobody any more.

What a command says there is lost then, and its work and exit status are not. A command whose product goes to standard
output writes it within `strict_output`, and ends when that is not possible.
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
"""Why what was written is lost, whatever was right about it."""
_STREAMS = (("stdin", "r"), ("stdout", "w"), ("stderr", "w"))


class _Outlet(io.FileIO):
    """A descriptor; `error` is why what was last written to it is lost."""

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


def take_over() -> None:
    """Open what is closed of the three standard streams, and have output that cannot be written lost.

    Streams that somebody has put in their place, as tests do, stay as they are.
    """
    for descriptor, (name, mode) in enumerate(_STREAMS):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
        stream = getattr(sys, name)
        if stream is not getattr(sys, f"__{name}__"):
            continue
        if mode == "r":
            sys.stdin = stream or open(descriptor, encoding="utf-8", closefd=False)  # noqa: SIM115  # while it runs
        elif stream is None or isinstance(stream, io.TextIOWrapper):
            setattr(sys, name, _tolerant(descriptor, stream))


def _tolerant(descriptor: int, stream: io.TextIOWrapper | None) -> io.TextIOWrapper:
    """As `stream` is set up, None for one that was closed."""
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
    """Within it standard output raises OSError when it cannot be written; nothing is left in its buffer after it."""
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


def lost_output() -> str:
    """Why something that was said on standard output is lost; empty when all is there, or nobody reads it any more."""
    sys.stdout.flush()
    error = getattr(_raw(sys.stdout), "error", None)
    return "" if error is None or error.errno == errno.EPIPE else str(error.strerror)
