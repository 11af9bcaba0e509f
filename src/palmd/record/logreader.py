"""Read an event log of any system: file format, order of events, and tolerated defects."""

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
MAX_BACKWARD_S = 1.0  # larger steps back in time mean that the file holds more than one run
MAX_GAP_S = 600.0
GZIP = b"\x1f\x8b"  # first bytes of a gzip file


class LogError(Exception):
    """A log that cannot be used; the text is one line `file:line: what is wrong`."""


class LogParser(Protocol):
    """Parser for the lines of one system's logs. Types of rig, events and log are the system's own.

    kinds: a line is of a known kind if it has one of these keys.
    """

    @property
    def kinds(self) -> Sequence[str]: ...

    def rig(self, line: Line) -> Any:
        """Parse the object under `rig` in line 1; raises BadLineError."""
        ...

    def events(self, t: float, line: Line, rig: Any) -> Iterator[Any]:
        """Yield the events of one line, None for a reading off the pad; raises BadLineError."""
        ...

    def log(self, rig: Any, events: tuple[Any, ...], notes: tuple[str, ...]) -> Any:
        """Build the log from rig, events and notes."""
        ...


def read_log_as(path: Path, parser_of: Callable[[str | None], LogParser]) -> tuple[LogParser, Any]:
    """Read an event log with the parser of the system that its line 1 names; raises LogError if it is unusable.

    parser_of: returns the parser for `rig.system` (None if the log names none); raises BadLineError. Unknown keys,
    lines of unknown kind, truth lines and readings off the pad are ignored. A truncated last line is dropped with a
    note. Events may be late by up to `MAX_BACKWARD_S` and keep the order of the file, which may be gzip-compressed.
    """
    try:
        with path.open("rb") as stream:
            if stream.peek(len(GZIP))[: len(GZIP)] != GZIP:
                return _Reader(path, parser_of).read(stream)
            with gzip.open(stream) as unpacked:
                return _Reader(path, parser_of).read(unpacked)
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise LogError(f"{path}: the gzip file is truncated or damaged") from None
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None


class _Reader:
    def __init__(self, path: Path, parser_of: Callable[[str | None], LogParser]) -> None:
        self._path = path
        self._parser_of = parser_of
        self._number = 0  # of the current line
        self._latest = -math.inf
        self._off_pad = self._unknown = 0

    def read(self, stream: BufferedIOBase) -> tuple[LogParser, Any]:
        notes: list[str] = []
        events: list[Any] = []
        parser: LogParser | None = None
        rig: Any = None
        for raw in iter(lambda: stream.readline(MAX_LINE_BYTES + 1), b""):
            self._number += 1
            try:
                if raw.isspace():
                    continue
                line = decoded(raw)
                if parser is None:
                    described = _described(line)
                    system = described.get("system")
                    if system is not None and not isinstance(system, str):
                        raise BadLineError(f"rig.system must be a name, got {shown(system)}")
                    selected = self._parser_of(system)
                    rig, parser = selected.rig(described), selected
                else:
                    events += self._events(line, parser, rig)
            except BadLineError as error:
                if parser is not None and not raw.endswith(b"\n") and len(raw) <= MAX_LINE_BYTES:
                    notes.append(f"{self._path}:{self._number}: the last line is truncated and was ignored")
                    break
                raise LogError(f"{self._path}:{self._number}: {error}") from None
        if parser is None:
            raise LogError(f"{self._path}:1: the file is empty; an event log begins with its palmd_log line")
        if not events:
            raise LogError(f"{self._path}:{self._number}: the log holds no events")
        for count, what in ((self._off_pad, "readings off the pad"), (self._unknown, "lines of an unknown kind")):
            if count:
                notes.append(f"{self._path}: {count} {what} ignored")
        return parser, parser.log(rig, tuple(events), tuple(notes))

    def _events(self, line: Line, parser: LogParser, rig: Any) -> Iterator[Any]:
        if "truth" in line:
            return
        if not any(kind in line for kind in parser.kinds):
            self._unknown += 1
            return
        t = number(line, "t")
        self._check_order(t)
        for event in parser.events(t, line, rig):
            if event is None:
                self._off_pad += 1
            else:
                yield event

    def _check_order(self, t: float) -> None:
        latest = self._latest
        if t < latest - MAX_BACKWARD_S:
            raise BadLineError(f"time goes back by {latest - t:g} s; a log must hold a single run")
        if t > latest + MAX_GAP_S and math.isfinite(latest):
            raise BadLineError(
                f"time jumps by {t - latest:g} s; t must be in seconds, and a log must hold a single run"
            )
        self._latest = max(t, latest)


def _described(line: Line) -> Line:
    if "palmd_log" not in line:
        raise BadLineError('the first line must be the header {"palmd_log":1,"rig":{…}}')
    if line["palmd_log"] != VERSION or type(line["palmd_log"]) is not int:
        raise BadLineError(f"palmd_log is {shown(line['palmd_log'])}; this palmd reads version {VERSION}")
    return block(line, "rig")
