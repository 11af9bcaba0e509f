"""Creates a printable report of a recorded run."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from palmd.cli.logs import read_any
from palmd.console.errors import BAD_INPUT, CliError, writing
from palmd.console.extras import missing, raise_if_other
from palmd.console.notes import print_notes
from palmd.console.progress import Progress, working
from palmd.record import is_recording
from palmd.record.run import AnyRun, RunError, read_any_run
from palmd.report.series import Series, series_of
from palmd.report.texts import outcome
from palmd.systems import LIVE, SYSTEMS, load_part

if TYPE_CHECKING:
    from palmd.report.sections import Report

LOGS = (".jsonl", ".jsonl.gz")
SUFFIXES = (".html", ".pdf")


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
    """Create the report and print the outcome; CliError for invalid inputs or outputs, or without matplotlib."""
    source: Path = arguments.run
    output: Path = arguments.output or Path(f"{Path(source.name.removesuffix('.gz')).stem}.html")
    if output.suffix.lower() not in SUFFIXES:
        raise CliError(BAD_INPUT, f"{output}: the suffix of a report must be {' or '.join(SUFFIXES)}")
    if not output.parent.is_dir():
        raise CliError(BAD_INPUT, f"{output}: cannot be written: there is no folder {output.parent}")
    is_log = source.name.lower().endswith(LOGS) and not is_recording(source)
    make, text = _of_log(source) if is_log else _of_run(source)
    if output.exists() and output.samefile(source):
        raise CliError(BAD_INPUT, f"{output}: is the input file; write to another file")
    report = _render(make, as_pdf=output.suffix.lower() == ".pdf")
    with writing(output):
        output.write_bytes(report)
    print(f"{output}: {text}")
    return 0


def _of_log(path: Path) -> tuple[Callable[[], Report], str]:
    """A function that makes the report of an event log, and its outcome."""
    system, log = read_any(path)
    report = SYSTEMS[system.name].log_report
    if not report:
        known = ", ".join(each.name for each in SYSTEMS.values() if each.log_report)
        raise CliError(BAD_INPUT, f"{path}: reports of event logs exist for {known} only; record the run")
    with working("reconstructing") as say:
        answer = system.reconstruct(log, 0, say)
    return lambda: load_part(report)(path.stem, answer.line), answer.summary


def _of_run(path: Path) -> tuple[Callable[[], Report], str]:
    """A function that makes the report of a recording, and its outcome."""
    try:
        recorded = read_any_run(path)
        print_notes(recorded.notes)
        series = _read(recorded)
    except RunError as error:
        raise CliError(BAD_INPUT, str(error)) from None
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: {error.strerror or error}") from None
    return lambda: load_part(LIVE[recorded.system].report)(series), outcome(series)


def _read(recorded: AnyRun) -> Series:
    survey = recorded.survey()
    with Progress("reading", sum(topic.count for topic in survey.values()), "messages") as progress:
        return series_of(recorded, survey, progress.at)


def _render(make: Callable[[], Report], *, as_pdf: bool) -> bytes:
    try:
        from palmd.report import html, pdf
    except ModuleNotFoundError as error:
        raise_if_other("matplotlib", error)
        raise missing("the report", "matplotlib", "report") from None
    logging.getLogger("fontTools").setLevel(logging.WARNING)  # it logs every glyph that it embeds
    report = make()
    with Progress("drawing", report.figure_count, "figures") as progress:
        return pdf.as_pdf(report, progress.at) if as_pdf else html.as_html(report, progress.at).encode()
