"""A recorded run as one file to read or print."""

from __future__ import annotations

import logging
from pathlib import Path

from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import missing, only_without
from palmd.console.progress import Progress
from palmd.record.run import Run, RunError, read_run
from palmd.report.series import Series, series_of
from palmd.report.words import outcome

SUFFIXES = (".html", ".pdf")


def run(recording: Path, output: Path) -> int:
    """Writes the report, prints the outcome; CliError when the run, the output or matplotlib is not there."""
    if output.suffix.lower() not in SUFFIXES:
        raise CliError(BAD_INPUT, f"{output}: a report is {' or '.join(SUFFIXES)}; name it so")
    if not output.parent.is_dir():
        raise CliError(BAD_INPUT, f"{output}: cannot be written: there is no folder {output.parent}")
    try:
        series = _read(read_run(recording))
    except RunError as error:
        raise CliError(BAD_INPUT, str(error)) from None
    except OSError as error:
        raise CliError(BAD_INPUT, f"{recording}: {error.strerror or error}") from None
    if output.exists() and output.samefile(recording):
        raise CliError(BAD_INPUT, f"{output}: is the run itself; write to another file")
    report = _drawn(series, as_pdf=output.suffix.lower() == ".pdf")
    try:
        output.write_bytes(report)
    except OSError as error:
        raise CliError(BAD_INPUT, f"{output}: cannot be written: {error.strerror or error}") from None
    print(f"{output}: {outcome(series)}")
    return 0


def _read(recorded: Run) -> Series:
    survey = recorded.survey()
    with Progress("reading", sum(topic.count for topic in survey.values()), "messages") as progress:
        return series_of(recorded, survey, progress.at)


def _drawn(series: Series, *, as_pdf: bool) -> bytes:
    try:
        from palmd.report import html, pdf, sections
    except ModuleNotFoundError as error:
        only_without("matplotlib", error)
        raise missing("the report", "matplotlib", "report") from None
    logging.getLogger("fontTools").setLevel(logging.WARNING)  # tells of every glyph that it embeds
    report = sections.report_of(series)
    with Progress("drawing", report.plates, "figures") as progress:
        return pdf.as_pdf(report, progress.at) if as_pdf else html.as_html(report, progress.at).encode()
