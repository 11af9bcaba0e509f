"""Creates a printable report of a recorded run."""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.cli.logs import read_any
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.progress import working
from palmd.record import is_recording
from palmd.report import command
from palmd.systems import SYSTEMS, load_part

LOGS = (".jsonl", ".jsonl.gz")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "run", type=Path, metavar="RUN",
        help="a recording, or an event log (.jsonl) of three palms, which is reconstructed for it",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE",
        help="FILE.html or FILE.pdf (default: RUN's name with .html, here)",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Create the report; CliError for invalid inputs."""
    subject: Path = arguments.run
    output: Path = arguments.output or Path(f"{Path(subject.name.removesuffix('.gz')).stem}.html")
    if not subject.name.lower().endswith(LOGS) or is_recording(subject):
        return command.run(subject, output)
    system, log = read_any(subject)
    report = SYSTEMS[system.name].log_report
    if not report:
        known = ", ".join(each.name for each in SYSTEMS.values() if each.log_report)
        raise CliError(BAD_INPUT, f"{subject}: reports of event logs exist for {known} only; record the run")
    with working("reconstructing") as say:
        answer = system.reconstruct(log, 0, say)
    status: int = load_part(report)(subject, answer.line, answer.summary, output)
    return status
