"""Compares a reconstruction with a camera's track of the same run; clock offset and frame are fitted."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from palmd.cli.logs import check_not_input, open_output, read
from palmd.console.errors import BAD_INPUT, CliError, as_cli_error, writing
from palmd.console.extras import importing
from palmd.events import PalmSample
from palmd.jsonvalues import or_none
from palmd.outlinefile import Outline, OutlineError, read_outline
from palmd.record.resultfile import Result, ResultError, read_result
from palmd.record.track import ANGLES, OBJECT, TIME, TrackError, read_track
from palmd.report.camera_frame import motion_of
from palmd.report.ground_truth import CameraComparison, GroundTruthError, as_line, compare, report_lines


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("result", type=Path, metavar="RESULT.json", help="as written by palmd reconstruct")
    add("track", type=Path, metavar="TRACK.csv",
        help=f"columns {','.join((TIME, *OBJECT))}, and {','.join(ANGLES)} if they are visible")  # fmt: skip
    add("--log", type=Path, metavar="LOG", help="event log or recording of the run, to compare positions too")
    add("--outline", type=Path, metavar="FILE", help="the object's true outline (.json, .csv)")
    add("-o", "--output", type=Path, metavar="REPORT.json", help="write all results as JSON; - for standard output")
    add("--figure", type=Path, metavar="FILE.svg", help="outline and orientation, after figure 3.15 of the paper")


def run(arguments: argparse.Namespace) -> int:
    """Compare first, then write the outputs; CliError if the comparison fails."""
    inputs = (arguments.result, arguments.track, arguments.log, arguments.outline)
    check_not_input((arguments.output, arguments.figure), inputs)
    if arguments.figure is not None and arguments.figure.suffix != ".svg":
        raise CliError(BAD_INPUT, f"{arguments.figure}: the figure is an SVG; name it .svg")
    with as_cli_error(ResultError, TrackError, OutlineError):
        result, track = read_result(arguments.result), read_track(arguments.track)
        outline = None if arguments.outline is None else read_outline(arguments.outline)
    rig, palms = None, []
    if arguments.log is not None:
        log = read(arguments.log)
        rig, palms = log.rig, [event for event in log.events if isinstance(event, PalmSample)]
        if not palms:
            raise CliError(BAD_INPUT, f"{arguments.log}: has no palm angles")
    with as_cli_error(GroundTruthError, before=f"{arguments.track}: "):
        found = compare(result, motion_of(result, rig, palms), track, outline)
    if arguments.figure is not None:
        _draw(result, found, outline, arguments.figure)
    if arguments.output is not None:
        with open_output(arguments.output, arguments.result) as stream:
            stream.write(json.dumps(or_none(as_line(found)), allow_nan=False) + "\n")
    print("\n".join(report_lines(found)), file=sys.stderr if arguments.output == Path("-") else sys.stdout)
    return 0


def _draw(result: Result, found: CameraComparison, outline: Outline | None, path: Path) -> None:
    with importing("--figure", "matplotlib", "report"):
        from palmd.report import ground_truth_figure
    with writing(path):
        ground_truth_figure.save(result, found, outline, path)
