"""Progress bar, and progress text for work of unknown length; on a terminal only."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

_QUIET_S = 1.0
_EVERY_S = 0.1
_WIDTH = 30
_CELLS, _PLAIN_CELLS = "█░", "#."
_ERASED = "\r\x1b[K"


class Progress:
    """Progress bar, shown after the first second if standard error is a terminal."""

    def __init__(self, what: str, total: int, unit: str, stream: TextIO | None = None) -> None:
        """`total` is the number of `unit` to be done."""
        self._what, self._total, self._unit = what, total, unit
        self._stream = stream or sys.stderr
        self._shows = self._stream.isatty()
        self._next = time.monotonic() + _QUIET_S
        self._shown = False

    def __enter__(self) -> Progress:
        return self

    def at(self, done: int) -> None:
        """Set the number done; cheap if nothing is shown."""
        if not self._shows or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + _EVERY_S
        self._shown = True
        filled = _WIDTH * done // self._total
        cells = _cells(self._stream)
        bar = cells[0] * filled + cells[1] * (_WIDTH - filled)
        self._stream.write(f"\r{self._what} {bar} {100 * done // self._total:3d} % of {self._total} {self._unit}")
        self._stream.flush()

    def __exit__(self, *_: object) -> None:
        if self._shown:
            self._stream.write(_ERASED)
            self._stream.flush()


@contextmanager
def working(what: str, stream: TextIO | None = None) -> Iterator[Callable[[str], None]]:
    """Context that shows the text `what`; yields a function that replaces it. For work of unknown length."""
    stream = stream or sys.stderr
    if not stream.isatty():
        yield lambda _: None
        return

    def say(doing: str) -> None:
        stream.write(f"{_ERASED}{doing} ...")
        stream.flush()

    stream.write(f"\r{what} ...")
    stream.flush()
    try:
        yield say
    finally:
        stream.write(_ERASED)
        stream.flush()


def _cells(stream: TextIO) -> str:
    """Characters for done and not done parts on this terminal."""
    try:
        _CELLS.encode(stream.encoding or "utf-8")
    except UnicodeEncodeError:
        return _PLAIN_CELLS
    return _CELLS
