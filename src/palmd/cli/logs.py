"""How a command reads a log, be it an event log or a recorded run, and where it writes what it makes of it."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from palmd.console.errors import BAD_INPUT, CliError
from palmd.record.eventlog import EventLog, LogError, read_log
from palmd.record.run import RunError, is_recording, read_run

STDOUT = Path("-")


def read(path: Path) -> EventLog:
    """The log at `path`, its notes told on standard error; CliError when it cannot be used.

    What it is shows in its first bytes; a file named as a recording is taken for one even so.
    """
    try:
        log = read_run(path).event_log() if is_recording(path) else read_log(path)
    except (LogError, RunError) as error:
        raise CliError(BAD_INPUT, str(error)) from None
    for note in log.notes:
        print(note, file=sys.stderr)
    return log


@contextlib.contextmanager
def opened(path: Path, log: Path) -> Iterator[TextIO]:
    """`path` for writing, `-` for standard output; CliError when that cannot be, or when it is the `log` itself."""
    if path == STDOUT:
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(encoding="utf-8")  # as in a file: what a terminal cannot show must not be lost
        yield sys.stdout
        return
    try:
        if path.exists() and path.samefile(log):
            raise CliError(BAD_INPUT, f"{path}: is the log itself; write to another file")
        with path.open("w", encoding="utf-8") as stream:
            yield stream
    except BrokenPipeError:
        raise
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: cannot be written: {error.strerror or error}") from None
