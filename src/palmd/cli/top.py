"""Shows the live status of a running daemon: state, estimate, contacts, motion, faults with hints, timing.

Ends with q or Ctrl-C. If standard output is no terminal, it prints plain text each second.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from types import FrameType

from palmd.bus.addresses import add_config, publish_address
from palmd.bus.command_client import TIMEOUT_S
from palmd.bus.link import PUBLISH, add_key, credentials, unreachable
from palmd.bus.subscriber import Subscriber
from palmd.cli.board import Board, BoardRow, fitted, frame
from palmd.console.keys import pressed, unbuffered
from palmd.console.output import strict_output
from palmd.keys import Credentials

REDRAW_S = 0.1
PLAIN_S = 1.0
ONCE_S = 1.2  # covers the topics of 1 Hz
_WIDE, _HIGH = 1000, 1000
_ENTER, _LEAVE = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"
_COLOURS = {"plain": "", "title": "1", "good": "32", "bad": "31;1", "warning": "33", "faint": "2"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--address", help=f"the daemon's publisher (default: as configured, {PUBLISH})")
    add_config(parser)
    add_key(parser)
    parser.add_argument("--once", action="store_true", help="print the status once and exit")


def run(arguments: argparse.Namespace) -> int:
    """Show the status until the end is requested; CliError with --once if there is no data."""
    address, key = publish_address(arguments.address, arguments.config), credentials(arguments)
    board = Board(address)
    with Subscriber(address, topics=("palm/",), key=key) as subscriber:
        if arguments.once:
            _once(board, subscriber, key)
        else:
            with strict_output():
                show = _live if sys.stdout.isatty() else _plain
                show(board, subscriber)
    return 0


def _once(board: Board, subscriber: Subscriber, key: Credentials | None) -> None:
    for message in subscriber.until(time.monotonic() + TIMEOUT_S):
        board.take(message)
        break
    else:
        raise unreachable(f"no data from {board.address}", key)
    _listen(board, subscriber, ONCE_S)
    _print(board)


def _plain(board: Board, subscriber: Subscriber) -> None:
    while True:
        _listen(board, subscriber, PLAIN_S)
        _print(board)
        print(flush=True)


def _print(board: Board) -> None:
    columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else _WIDE
    for row in fitted(frame(board, time.monotonic()), columns, _HIGH):
        print(row.text.rstrip())


def _live(board: Board, subscriber: Subscriber) -> None:
    keys = sys.stdin.fileno() if sys.stdin.isatty() else None
    with _screen(keys):
        while True:
            _listen(board, subscriber, REDRAW_S)
            size = shutil.get_terminal_size()
            sys.stdout.write(painted(frame(board, time.monotonic()), size.columns, size.lines))
            sys.stdout.flush()
            if keys is not None and pressed(keys, 1) in (b"q", b"Q"):
                return


def _listen(board: Board, subscriber: Subscriber, seconds: float) -> None:
    for message in subscriber.until(time.monotonic() + seconds):
        board.take(message)


@contextmanager
def _screen(keys: int | None) -> Iterator[None]:
    """Context: alternate screen and unbuffered keys; restored in any case."""
    handler = signal.signal(signal.SIGTERM, _interrupt)
    try:
        with nullcontext() if keys is None else unbuffered(keys):
            sys.stdout.write(_ENTER)
            yield
    except KeyboardInterrupt:
        pass
    finally:
        signal.signal(signal.SIGTERM, handler)
        sys.stdout.write(_LEAVE)
        sys.stdout.flush()


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def painted(rows: list[BoardRow], columns: int, lines: int) -> str:
    """Return the rows for a terminal of this size as an update of the screen."""
    shown = fitted(rows, columns, lines)
    drawn = [f"\x1b[{_COLOURS[row.style]}m{row.text}\x1b[m\x1b[K" for row in shown]
    return "\x1b[H" + "\n".join(drawn) + "\x1b[J"
