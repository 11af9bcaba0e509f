"""A recorded run as a printable report. `palmd report paper`: the runs behind the figures of CMU-CS-01-107 instead."""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.cli.logs import read_any
from palmd.cli.table import below, loaded
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.progress import working
from palmd.record import is_recording
from palmd.report import command

PAPER = "paper"
LOGS = (".jsonl", ".jsonl.gz")
BODIES = "three_palms"
_LOGS = "event logs with their truth beside them (LOG without .jsonl, plus .truth.json); default: four simulated runs"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "subject",
        metavar="RUN",
        help="a recording; an event log (.jsonl) of three palms, which is reconstructed for it; or the word "
        f"{PAPER}: figures 3.6, 3.8 to 3.11 and 3.15 (for a recording of that name: "
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
    subject = Path(arguments.subject)
    output: Path = arguments.output or Path(f"{Path(subject.name.removesuffix('.gz')).stem}.html")
    if not subject.name.lower().endswith(LOGS) or is_recording(subject):
        return command.run(subject, output)
    system, log = read_any(subject)
    if system.name != BODIES:
        raise CliError(BAD_INPUT, f"{subject}: of an event log there is a report for {BODIES} only; record the run")
    with working("reconstructing") as say:
        answer = system.reconstruct(log, 0, say)
    return command.run_body(subject, answer.line, answer.told, output)
