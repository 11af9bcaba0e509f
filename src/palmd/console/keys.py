"""Unbuffered keyboard input from a terminal."""

from __future__ import annotations

import os
import select
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def unbuffered(terminal: int) -> Iterator[int]:
    """Context: keys without Enter and without echo; the terminal is restored at the end."""
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield terminal
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def pressed(terminal: int, most: int = 1024) -> bytes:
    """Return at most `most` bytes of pressed keys; never blocks."""
    ready, _, _ = select.select([terminal], [], [], 0)
    return os.read(terminal, most) if ready else b""
