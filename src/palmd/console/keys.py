"""A terminal's keys as they are pressed."""

from __future__ import annotations

import os
import select
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def unbuffered(terminal: int) -> Iterator[int]:
    """Keys without Enter and without echo; the terminal as before in the end."""
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield terminal
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def pressed(terminal: int, most: int = 1024) -> bytes:
    """At most so many bytes of what has been pressed; never waits."""
    ready, _, _ = select.select([terminal], [], [], 0)
    return os.read(terminal, most) if ready else b""
