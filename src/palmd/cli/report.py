"""A recorded run as a printable report. `palmd report paper`: the runs behind the figures of CMU-CS-01-107 instead."""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.cli.table import below, loaded
from palmd.console.errors import BAD_INPUT, CliError
from palmd.report import command

PAPER = "paper"
_LOGS = "event logs with their truth beside them (LOG without .jsonl, plus .truth.json); default: four simulated runs"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "subject",
        metavar="RUN",
        help=f"a recording; or the word {PAPER}: figures 3.6, 3.8 to 3.11 and 3.15 (for a recording of that name: "
        f"./{PAPER})",
    )
    parser.add_argument("logs", nargs="*", type=Path, default=[], metavar="LOG", help=f"for {PAPER}: {_LOGS}")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help=f"FILE.html or FILE.pdf (default: RUN's name with .html, here); for {PAPER} a folder (default: here)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Makes the report; CliError when something cannot be used."""
    if arguments.subject == PAPER:
        status: int = loaded(below("report")[PAPER]).run(arguments.logs, arguments.output or Path())
        return status
    if arguments.logs:
        raise CliError(BAD_INPUT, f"{arguments.logs[0]}: one report is about one run; make another for this one")
    recording = Path(arguments.subject)
    return command.run(recording, arguments.output or Path(f"{recording.stem}.html"))
