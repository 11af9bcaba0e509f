"""Compares runs with each other, with an emulated rig's truth or with an external track: table of errors and figure.

A file is a recording (.mcap), a result of `palmd reconstruct` (.json), a track of a camera (.csv with the columns t_s,
object_x_mm, object_y_mm, object_angle_deg) or a track in the TUM format (.tum: time x y z qx qy qz qw, in s and m). The
reference is the file of --reference; without it the truth, for recordings of an emulated rig, else the first file.
Clock offset, frame, constant rotation and the tracked point on the object are fitted.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from palmd.cli.logs import check_not_input, open_output
from palmd.console.columns import aligned, number
from palmd.console.errors import BAD_INPUT, CliError, as_cli_error, writing
from palmd.console.extras import importing
from palmd.jsonvalues import or_none
from palmd.report.alignment import AlignmentError, TrajectoryComparison, compare
from palmd.report.tracks import PoseTrack, TrackFileError, read_pose_track

_FIGURES = (".svg", ".png", ".pdf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("files", type=Path, nargs="+", metavar="RUN", help="recordings, results and tracks")
    add("--reference", type=Path, metavar="FILE", help="reference for all comparisons")
    add("-o", "--output", type=Path, metavar="FILE.json", help="write all results as JSON; - for standard output")
    add("--figure", type=Path, metavar="FILE.svg", help="errors over time and outlines (.svg, .png, .pdf)")


def run(arguments: argparse.Namespace) -> int:
    """Compare first, then write the outputs; CliError for files that cannot be read or aligned."""
    files, reference = arguments.files, arguments.reference
    check_not_input((arguments.output, arguments.figure), (*files, reference))
    if arguments.figure is not None and arguments.figure.suffix not in _FIGURES:
        raise CliError(BAD_INPUT, f"{arguments.figure}: use the suffix {', '.join(_FIGURES)} for a figure")
    with as_cli_error(TrackFileError, AlignmentError):
        sources = [read_pose_track(path) for path in files]
        common = read_pose_track(reference) if reference else None
        pairs = _pairs(sources, common)
        found = [compare(true, each, fit=each.truth is not true) for true, each in pairs]
    if arguments.figure is not None:
        _draw(found, pairs, arguments.figure)
    if arguments.output is not None:
        with open_output(arguments.output, files[0]) as stream:
            stream.write(json.dumps(or_none([_as_map(each) for each in found]), allow_nan=False) + "\n")
    print(_table(found), file=sys.stderr if arguments.output == Path("-") else sys.stdout)
    return 0


def _pairs(sources: list[PoseTrack], common: PoseTrack | None) -> list[tuple[PoseTrack, PoseTrack]]:
    """Pair each source with its reference."""
    if common is not None:
        return [(common, each) for each in sources]
    if all(each.truth is not None for each in sources):
        return [(each.truth, each) for each in sources if each.truth is not None]
    if len(sources) == 1:
        raise CliError(
            BAD_INPUT, f"{sources[0].name}: has no truth to compare with: name a second run or --reference FILE"
        )
    return [(sources[0], each) for each in sources[1:]]


def _table(found: list[TrajectoryComparison]) -> str:
    heads = ("against", "for", "valid", "clock", "position", "largest", "rotation", "largest", "outline", "largest")
    rows: list[tuple[str, tuple[str, ...]]] = [("file", heads)]
    for each in found:
        place, turn, outline = each.position, each.rotation, each.outline
        cells = (
            each.reference,
            f"{each.t[-1] - each.t[0]:.1f} s",
            f"{each.valid:.0%}" if math.isfinite(each.valid) else "–",
            f"{each.offset_s:+.3f} s" if each.fitted else "same",
            *(number(value, 1e3, 3, " mm") for value in (place.rms, place.largest)),
            *(number(value, 180.0 / math.pi, 2, " °") for value in (turn.rms, turn.largest)),
            *(number(value, 1e6, 0, " µm") for value in (outline.rms, outline.largest)),
        )
        rows.append((each.source, cells))
    return aligned(rows) + "\nposition, rotation, outline: RMS errors; the outline's where it was touched"


def _as_map(each: TrajectoryComparison) -> dict[str, Any]:
    """All results except the errors over time, with units in the keys."""
    spreads = {"position": ("m", each.position), "rotation": ("rad", each.rotation), "outline": ("m", each.outline)}
    return {
        "file": each.source,
        "reference": each.reference,
        "compared_s": float(each.t[-1] - each.t[0]),
        "rows": len(each.t),
        "valid_share": each.valid,
        "clock_offset_s": each.offset_s,
        "fitted": each.fitted,
    } | {
        f"{name}_{key}_{unit}": value
        for name, (unit, spread) in spreads.items()
        for key, value in asdict(spread).items()
    }


def _draw(found: list[TrajectoryComparison], pairs: list[tuple[PoseTrack, PoseTrack]], path: Path) -> None:
    with importing("--figure", "matplotlib", "report"):
        from palmd.report import compare_figure
    with writing(path):
        compare_figure.save([(each, pair[1].body, pair[0].body) for each, pair in zip(found, pairs, strict=True)], path)
