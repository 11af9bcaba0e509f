"""Finds which of the stored outlines the object of a log has: the probability of each, and of none."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

from palmd import observer
from palmd.cli.logs import STDOUT, open_output, read, read_outlines
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.progress import Progress
from palmd.events import ObjectEstimate
from palmd.record.eventlog import EventLog
from palmd.record.recognition import as_line, table, verdict
from palmd.record.replay import replay, tick_count


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("log", type=Path, metavar="LOG", help="an event log (JSON lines) or a recorded run (.mcap)")
    parser.add_argument("library", type=Path, metavar="LIBRARY", help="a folder of outlines (.json, .csv), or one file")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="OUT.json", help="write JSON; - for standard output, without the table"
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the table after the last event; CliError if log or library are invalid, or nothing was touched."""
    outlines = read_outlines(arguments.library)
    log = read(arguments.log)
    found = verdict(_estimates(log, observer.make("shape", log.rig, outlines=outlines)))
    if found is None:
        raise CliError(BAD_INPUT, f"{arguments.log}: the object never touched both palms: it cannot be recognised")
    if arguments.output != STDOUT:
        print(table(found))
    if arguments.output is not None:
        with open_output(arguments.output, arguments.log) as stream:
            stream.write(json.dumps(as_line(found), allow_nan=False, ensure_ascii=False) + "\n")
    return 0


def _estimates(log: EventLog, recogniser: observer.Observer) -> Iterator[ObjectEstimate]:
    with Progress("recognising", tick_count(log), "ticks") as progress:
        for tick in replay(log, recogniser):
            estimate = recogniser.identify(tick.t)
            if estimate is not None:
                yield estimate
            progress.at(tick.number)
