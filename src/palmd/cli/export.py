"""Converts a recorded run to the formats of other programs: event log, CSV, MCAP with JSON, rerun, LeRobot, CAD.

A drawing (.svg, .dxf, .csv) shows the last valid outline of the run, or that of a RESULT.json written by
`palmd reconstruct`, in mm, with its band.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

from palmd.cli.logs import curves_of_result, drawing, write_drawing
from palmd.console.errors import BAD_INPUT, CliError, as_cli_error, writing
from palmd.console.extras import missing
from palmd.console.notes import print_notes
from palmd.console.progress import Progress
from palmd.record.export import DRAWINGS, FORMATS, ExportError, export, format_of, passes
from palmd.record.run import RunError, read_any_run

_NEEDED = {"lerobot": ("pandas", "lerobot")}
"""Package and extra that a format needs; default rerun."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("run", type=Path, metavar="RUN", help="a recorded run (.mcap), or a RESULT.json")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE|FOLDER",
        help=".jsonl event log; folder or .zip CSV, a table for each topic; .mcap messages in JSON; .rrd for rerun; "
        "with --as lerobot, a folder: a LeRobot data set; the outline: .svg, .dxf drawings, .csv points, x and y in mm",
    )  # fmt: skip
    parser.add_argument("--as", dest="form", choices=FORMATS, help="the format, if the name does not determine it")


def run(arguments: argparse.Namespace) -> int:
    """Write the output completely or not at all; CliError if the run is invalid or the output cannot be written."""
    source, target = arguments.run, arguments.output
    form = arguments.form or format_of(target)
    if form is None:
        raise CliError(BAD_INPUT, f"{target}: the name does not determine the format; add --as {'|'.join(FORMATS)}")
    if source.suffix.lower() == ".json":
        if form not in DRAWINGS:
            raise CliError(BAD_INPUT, f"{source}: only the outline of a result can be exported: .svg, .dxf or .csv")
        write_drawing(curves_of_result(source), target, drawing(DRAWINGS[form]), source)
        return 0
    if form in DRAWINGS:
        drawing(DRAWINGS[form])
    try:
        with as_cli_error(RunError, ExportError), writing(target):
            recording = read_any_run(source)
            count = itertools.count(1)
            with Progress("export", passes(form) * recording.layout.count, "messages") as progress:
                export(recording, target, form, lambda: progress.at(next(count)))
    except ModuleNotFoundError as error:
        package, extra = _NEEDED.get(form, ("rerun-sdk", "rerun"))
        if (error.name or "").partition(".")[0] not in ("rerun", "pandas", "pyarrow"):
            raise
        raise missing(f"the format {form}", package, extra) from None
    except ImportError as error:  # of pandas, which has no pyarrow
        raise missing(f"the format {form}", "pyarrow", "lerobot") from error
    print_notes(recording.notes)
    return 0
