"""Reads an event log of any system: what a file may hold, in which order, and what of it is forgiven."""

from __future__ import annotations

import gzip
import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from io import BufferedIOBase
from pathlib import Path
from typing import Any, Protocol

from palmd.record.logline import MAX_LINE_BYTES, BadLineError, Line, block, decoded, number, shown

VERSION = 1
MAX_BACKWARD_S = 1.0  # an event that comes late is one thing, another run in the same file another
MAX_GAP_S = 600.0
GZIP = b"\x1f\x8b"  # what a file packed by gzip begins with


class LogError(Exception):
    """A log that cannot be used; its text is one line `file:line: what`."""


class LogForm(Protocol):
    """How the lines of one system's logs are read; what it makes of them is the system's own affair.

    kinds: a line is of a known kind when it has one of these keys.
    """

    @property
    def kinds(self) -> Sequence[str]: ...

    def rig(self, line: Line) -> Any:
        """What line 1 says under `rig`; raises BadLineError."""
        ...

    def events(self, t: float, line: Line, rig: Any) -> Iterator[Any]:
        """The events of one line, None for a reading that lies off the pad; raises BadLineError."""
        ...

    def log(self, rig: Any, events: tuple[Any, ...], notes: tuple[str, ...]) -> Any:
        """The log that they make."""
        ...


def read_log_as(path: Path, form_of: Callable[[str | None], LogForm]) -> tuple[LogForm, Any]:
    """Read an event log in the form of the system that its line 1 names; raises LogError for what makes it unusable.

    form_of: the form by `rig.system`, None where a log names none; raises BadLineError. Unknown keys and lines of an
    unknown kind are ignored, so are truth lines and readings that lie off the pad. A last line that was cut off is
    dropped with a note. Events may come late by `MAX_BACKWARD_S`; they keep the order of the file, which may be packed
    by gzip.
    """
    try:
        with path.open("rb") as stream:
            if stream.peek(len(GZIP))[: len(GZIP)] != GZIP:
                return _Reader(path, form_of).read(stream)
            with gzip.open(stream) as unpacked:
                return _Reader(path, form_of).read(unpacked)
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise LogError(f"{path}: packed by gzip, but cut off or damaged") from None
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None


class _Reader:
    def __init__(self, path: Path, form_of: Callable[[str | None], LogForm]) -> None:
        self._path = path
        self._form_of = form_of
        self._number = 0  # of the line in hand
        self._latest = -math.inf
        self._off_pad = self._unknown = 0

    def read(self, stream: BufferedIOBase) -> tuple[LogForm, Any]:
        notes: list[str] = []
        events: list[Any] = []
        form: LogForm | None = None
        rig: Any = None
        for raw in iter(lambda: stream.readline(MAX_LINE_BYTES + 1), b""):
            self._number += 1
            try:
                if raw.isspace():
                    continue
                line = decoded(raw)
                if form is None:
                    described = _described(line)
                    system = described.get("system")
                    if system is not None and not isinstance(system, str):
                        raise BadLineError(f"rig.system must be a name, got {shown(system)}")
                    found = self._form_of(system)
                    rig, form = found.rig(described), found
                else:
                    events += self._events(line, form, rig)
            except BadLineError as error:
                if form is not None and not raw.endswith(b"\n") and len(raw) <= MAX_LINE_BYTES:
                    notes.append(f"{self._path}:{self._number}: the last line was cut off and is left out")
                    break
                raise LogError(f"{self._path}:{self._number}: {error}") from None
        if form is None:
            raise LogError(f"{self._path}:1: the file is empty; an event log begins with its palmd_log line")
        if not events:
            raise LogError(f"{self._path}:{self._number}: the log holds no events")
        for count, what in ((self._off_pad, "readings off the pad"), (self._unknown, "lines of an unknown kind")):
            if count:
                notes.append(f"{self._path}: {count} {what} left out")
        return form, form.log(rig, tuple(events), tuple(notes))

    def _events(self, line: Line, form: LogForm, rig: Any) -> Iterator[Any]:
        if "truth" in line:
            return
        if not any(kind in line for kind in form.kinds):
            self._unknown += 1
            return
        t = number(line, "t")
        self._check_order(t)
        for event in form.events(t, line, rig):
            if event is None:
                self._off_pad += 1
            else:
                yield event

    def _check_order(self, t: float) -> None:
        latest = self._latest
        if t < latest - MAX_BACKWARD_S:
            raise BadLineError(f"time runs backwards by {latest - t:g} s; is this more than one run?")
        if t > latest + MAX_GAP_S and math.isfinite(latest):
            raise BadLineError(f"time jumps by {t - latest:g} s; t is in seconds, and a log holds one run")
        self._latest = max(t, latest)


def _described(line: Line) -> Line:
    if "palmd_log" not in line:
        raise BadLineError('the first line must be the header {"palmd_log":1,"rig":{…}}')
    if line["palmd_log"] != VERSION or type(line["palmd_log"]) is not int:
        raise BadLineError(f"palmd_log is {shown(line['palmd_log'])}; this palmd reads version {VERSION}")
    return block(line, "rig")
