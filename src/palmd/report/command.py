"""The command `palmd report`: write the report of a recorded run as HTML or PDF."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palmd.console.errors import BAD_INPUT, CliError, writing
from palmd.console.extras import missing, raise_if_other
from palmd.console.notes import print_notes
from palmd.console.progress import Progress
from palmd.record.run import AnyRun, RunError, read_any_run
from palmd.report.series import Series, series_of
from palmd.report.texts import outcome
from palmd.systems import LIVE, load_part

if TYPE_CHECKING:
    from palmd.report.sections import Report

SUFFIXES = (".html", ".pdf")


def run(recording: Path, output: Path) -> int:
    """Write the report and print the outcome; raises CliError for an unusable run or output, or without matplotlib."""
    _check(output)
    try:
        recorded = read_any_run(recording)
        print_notes(recorded.notes)
        series = _read(recorded)
    except RunError as error:
        raise CliError(BAD_INPUT, str(error)) from None
    except OSError as error:
        raise CliError(BAD_INPUT, f"{recording}: {error.strerror or error}") from None

    def make() -> Report:
        report: Report = load_part(LIVE[recorded.system].report)(series)
        return report

    _write(make, recording, output)
    print(f"{output}: {outcome(series)}")
    return 0


def run_body(source: Path, result: Mapping[str, Any], outcome: str, output: Path) -> int:
    """Write the report of a result of `palmd reconstruct` for three palms, reconstructed from the log `source`."""
    _check(output)

    def make() -> Report:
        from palmd.report.body_report import body_report

        return body_report(source.stem, result)

    _write(make, source, output)
    print(f"{output}: {outcome}")
    return 0


def _check(output: Path) -> None:
    if output.suffix.lower() not in SUFFIXES:
        raise CliError(BAD_INPUT, f"{output}: the suffix of a report must be {' or '.join(SUFFIXES)}")
    if not output.parent.is_dir():
        raise CliError(BAD_INPUT, f"{output}: cannot be written: there is no folder {output.parent}")


def _write(make: Callable[[], Report], source: Path, output: Path) -> None:
    if output.exists() and output.samefile(source):
        raise CliError(BAD_INPUT, f"{output}: is the input file; write to another file")
    report = _render(make, as_pdf=output.suffix.lower() == ".pdf")
    with writing(output):
        output.write_bytes(report)


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
