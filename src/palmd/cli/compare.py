"""Compares runs with each other, with an emulated rig's truth or with an external track: table of errors and figure.

A file is a recording (.mcap), a result of `palmd reconstruct` (.json), a track of a camera (.csv with the columns t_s,
object_x_mm, object_y_mm, object_angle_deg) or a track in the TUM format (.tum: time x y z qx qy qz qw, in s and m). The
reference is the file of --reference; without it the truth, for recordings of an emulated rig, else the only track among
the files, else the first file. Clock offset and drift, frame, constant rotation and the tracked point on the object are
fitted, with standard deviations.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from palmd.cli.logs import check_not_input, open_output, read
from palmd.console.columns import aligned, number
from palmd.console.errors import BAD_INPUT, CliError, as_cli_error, writing
from palmd.console.extras import importing
from palmd.events import FloatArray, PalmSample
from palmd.jsonvalues import or_none
from palmd.outlinefile import OutlineError, read_outline
from palmd.polygon import degrees
from palmd.report.alignment import Alignment, AlignmentError, TrajectoryComparison, compare
from palmd.report.tracks import OutlineShape, PoseTrack, TrackFileError, read_pose_track
from palmd.system.description import RigDescription

_FIGURES = (".svg", ".png", ".pdf")
TRACKS = (".csv", ".tum", ".txt")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("files", type=Path, nargs="+", metavar="RUN", help="recordings, results and tracks")
    add("--reference", type=Path, metavar="FILE", help="reference for all comparisons")
    add("--log", type=Path, metavar="LOG", help="event log or recording of a result's run, for its positions")
    add("--outline", type=Path, metavar="FILE", help="the object's true outline (.json, .csv)")
    add("-o", "--output", type=Path, metavar="FILE.json", help="write all results as JSON; - for standard output")
    add("--figure", type=Path, metavar="FILE.svg", help="errors over time and outlines (.svg, .png, .pdf)")


def run(arguments: argparse.Namespace) -> int:
    """Compare first, then write the outputs; CliError for files that cannot be read or aligned."""
    files, reference = arguments.files, arguments.reference
    check_not_input((arguments.output, arguments.figure), (*files, reference, arguments.log, arguments.outline))
    if arguments.figure is not None and arguments.figure.suffix not in _FIGURES:
        raise CliError(BAD_INPUT, f"{arguments.figure}: use the suffix {', '.join(_FIGURES)} for a figure")
    palms = None if arguments.log is None else _palms(arguments.log)
    with as_cli_error(TrackFileError, AlignmentError, OutlineError):
        sources = [read_pose_track(path, palms) for path in files]
        tracks = [each for each, path in zip(sources, files, strict=True) if path.suffix in TRACKS]
        common = read_pose_track(reference, palms) if reference else tracks[0] if len(tracks) == 1 else None
        pairs = _pairs(sources, common)
        fitted = [each.truth is not true for true, each in pairs]
        if arguments.outline is not None:
            body = OutlineShape(degrees(), read_outline(arguments.outline).h, np.ones(360))
            pairs = [(replace(true, body=body), each) for true, each in pairs]
        found = [compare(true, each, fit=fit) for (true, each), fit in zip(pairs, fitted, strict=True)]
    if arguments.figure is not None:
        _draw(found, pairs, arguments.figure)
    if arguments.output is not None:
        with open_output(arguments.output, files[0]) as stream:
            stream.write(json.dumps(or_none([_as_map(each) for each in found]), allow_nan=False) + "\n")
    print(
        "\n".join([_table(found), *map(_alignment_text, found)]).rstrip(),
        file=sys.stderr if arguments.output == Path("-") else sys.stdout,
    )
    return 0


def _palms(path: Path) -> tuple[RigDescription, Sequence[PalmSample]]:
    """Rig and palm angles of an event log or recording; CliError if there are none."""
    log = read(path)
    samples = [event for event in log.events if isinstance(event, PalmSample)]
    if not samples:
        raise CliError(BAD_INPUT, f"{path}: has no palm angles")
    return log.rig, samples


def _pairs(sources: list[PoseTrack], common: PoseTrack | None) -> list[tuple[PoseTrack, PoseTrack]]:
    """Pair each source with its reference."""
    if common is None and all(each.truth is not None for each in sources):
        return [(each.truth, each) for each in sources if each.truth is not None]
    common = common or sources[0]
    pairs = [(common, each) for each in sources if each is not common]
    if not pairs:
        raise CliError(
            BAD_INPUT, f"{sources[0].name}: has no truth to compare with: name a second run or --reference FILE"
        )
    return pairs


def _table(found: list[TrajectoryComparison]) -> str:
    heads = ("against", "for", "valid", "clock", "position", "largest", "rotation", "largest", "outline", "largest")
    rows: list[tuple[str, tuple[str, ...]]] = [("file", heads)]
    for each in found:
        place, turn, outline = each.position, each.rotation, each.outline
        cells = (
            each.reference,
            f"{each.t[-1] - each.t[0]:.1f} s",
            f"{each.valid:.0%}" if math.isfinite(each.valid) else "–",
            f"{each.alignment.offset:+.3f} s" if each.alignment else "same",
            *(number(value, 1e3, 3, " mm") for value in (place.rms, place.largest)),
            *(number(value, 180.0 / math.pi, 2, " °") for value in (turn.rms, turn.largest)),
            *(number(value, 1e6, 0, " µm") for value in (outline.rms, outline.largest)),
        )
        rows.append((each.source, cells))
    return aligned(rows) + "\nposition, rotation, outline: RMS errors; the outline's where it was touched"


def _alignment_text(each: TrajectoryComparison) -> str:
    """Clock, frame and tracked point with their standard deviations, on one line; empty if nothing was fitted."""
    found = each.alignment
    if found is None:
        return ""
    angle = float(np.linalg.norm(found.frame))
    along = found.frame / angle if angle > 0.0 else np.ones(3)
    angle_sd = float(np.linalg.norm(np.where(along != 0.0, along * found.frame_sd, 0.0)))
    parts = [f"clock {found.offset:+.4f} s ± {found.offset_sd * 1e3:.1f} ms"]
    if math.isfinite(found.drift):
        parts.append(f"drift {found.drift * 1e6:.1f} ± {found.drift_sd * 1e6:.1f} ppm")
    if math.isfinite(angle_sd):
        parts.append(f"frame turned by {math.degrees(angle):.2f} ± {math.degrees(angle_sd):.2f}°")
    for what, value, sd in (("origin at", found.place, found.place_sd), ("point at", found.mark, found.mark_sd)):
        known = np.isfinite(sd)
        if known.any():
            parts.append(f"{what} {_vector(np.where(known, value, 0.0))} ± {np.nanmax(sd) * 1e3:.2f} mm")
    return f"{each.source} in {each.reference}: {', '.join(parts)}"


def _vector(values: FloatArray) -> str:
    return f"({', '.join(f'{value * 1e3:.2f}' for value in values)})"


def _as_map(each: TrajectoryComparison) -> dict[str, Any]:
    """All results except the errors over time, with units in the keys."""
    spreads = {"position": ("m", each.position), "rotation": ("rad", each.rotation), "outline": ("m", each.outline)}
    return {
        "file": each.source,
        "reference": each.reference,
        "compared_s": float(each.t[-1] - each.t[0]),
        "rows": len(each.t),
        "valid_share": each.valid,
        **_alignment_map(each.alignment),
    } | {
        f"{name}_{key}_{unit}": value
        for name, (unit, spread) in spreads.items()
        for key, value in asdict(spread).items()
    }


def _alignment_map(found: Alignment | None) -> dict[str, Any]:
    if found is None:
        return {"clock_offset_s": 0.0, "fitted": False}
    values = {"clock_offset_s": found.offset, "clock_offset_sd_s": found.offset_sd, "clock_middle_s": found.t_middle,
              "clock_drift": found.drift, "clock_drift_sd": found.drift_sd, "fitted": True}  # fmt: skip
    vectors = {
        "frame_rad": found.frame, "frame_sd_rad": found.frame_sd, "origin_m": found.place,
        "origin_sd_m": found.place_sd, "point_m": found.mark, "point_sd_m": found.mark_sd,
    }  # fmt: skip
    return values | {name: value.tolist() for name, value in vectors.items()}


def _draw(found: list[TrajectoryComparison], pairs: list[tuple[PoseTrack, PoseTrack]], path: Path) -> None:
    with importing("--figure", "matplotlib", "report"):
        from palmd.report import compare_figure
    with writing(path):
        compare_figure.save([(each, pair[1].body, pair[0].body) for each, pair in zip(found, pairs, strict=True)], path)
