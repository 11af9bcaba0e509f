"""A terminal's keys: taken one by one without Enter, without waiting, and the terminal is as it was afterwards."""

import contextlib
import os
import pty
import termios

import pytest

from palmd.console.keys import pressed, unbuffered


@pytest.fixture
def terminal():
    far, near = pty.openpty()
    yield far, near
    os.close(far)
    os.close(near)


def test_keys_come_without_enter_and_nobody_waits_for_them(terminal):
    far, near = terminal
    with unbuffered(near) as keys:
        assert pressed(keys) == b""
        os.write(far, b"abc")
        assert pressed(keys, 1) == b"a"
        assert pressed(keys) == b"bc"


def test_the_terminal_is_as_it_was_however_it_ends(terminal):
    _, near = terminal
    before = termios.tcgetattr(near)
    with contextlib.suppress(KeyboardInterrupt), unbuffered(near):
        assert termios.tcgetattr(near) != before
        raise KeyboardInterrupt
    assert termios.tcgetattr(near) == before
