"""A terminal's keys are read one by one without Enter and without waiting; the terminal's settings are restored."""

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


def test_keys_are_read_without_enter_and_without_waiting(terminal):
    far, near = terminal
    with unbuffered(near) as keys:
        assert pressed(keys) == b""
        os.write(far, b"abc")
        assert pressed(keys, 1) == b"a"
        assert pressed(keys) == b"bc"


def test_the_terminals_settings_are_restored_after_an_interrupt(terminal):
    _, near = terminal
    before = termios.tcgetattr(near)
    with contextlib.suppress(KeyboardInterrupt), unbuffered(near):
        assert termios.tcgetattr(near) != before
        raise KeyboardInterrupt
    assert termios.tcgetattr(near) == before
