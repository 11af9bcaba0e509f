"""Replays an event log or recorded run causally through the daemon's observer: one JSON line every 10 ms."""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd import observer
from palmd.cli.logs import add_calibration_argument, open_output, read_any, read_outlines
from palmd.console.errors import BAD_INPUT, CliError, as_cli_error
from palmd.console.progress import Progress, working
from palmd.record.replay import texts, tick_count
from palmd.record.systems import NotYetError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("log", type=Path, metavar="LOG", help="an event log (JSON lines) or a recorded run (.mcap)")
    add("-o", "--output", type=Path, required=True, metavar="OUT.jsonl", help="- for standard output")
    add("--observer", type=_observer, default=observer.OBSERVERS[0], metavar="|".join(observer.OBSERVERS),
        help="default: %(default)s")  # fmt: skip
    add("--shape", type=Path, metavar="OUTLINE|FOLDER",
        help="stored outline or folder of outlines, one of which the object may have")  # fmt: skip
    add_calibration_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Read the whole log before writing; CliError if the log is invalid."""
    if arguments.shape is not None and arguments.observer != "shape":
        raise CliError(BAD_INPUT, f"--shape needs --observer shape: {arguments.observer} cannot use a stored outline")
    outlines = () if arguments.shape is None else read_outlines(arguments.shape)
    system, log = read_any(arguments.log, arguments.calibration_sd)
    preparing = working(f"preparing the {arguments.observer} observer")
    with as_cli_error(NotYetError, before=f"{arguments.log}: "), preparing:
        ticks = system.estimate(log, arguments.observer, outlines)
    with (
        open_output(arguments.output, arguments.log) as stream,
        Progress(f"{arguments.observer} observer", tick_count(log), "ticks") as progress,
    ):
        for tick in ticks:
            for line in texts(tick):
                stream.write(line + "\n")
            progress.at(tick.number)
    return 0


def _observer(name: str) -> str:
    if name in observer.OBSERVERS:
        return name
    known = ", ".join(observer.OBSERVERS)
    raise argparse.ArgumentTypeError(f"there is no observer {name!r}; choose from {known}")
