"""Draw docs/figures/camera.svg and pruning.svg from seeded simulated runs."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from palmd.events import PalmSample
from palmd.observer.palm_path import smoothed_path
from palmd.observer.reconstruct import reconstruct
from palmd.polygon import degrees
from palmd.report import compare_figure
from palmd.report.alignment import compare
from palmd.report.tracks import OutlineShape, PoseTrack, com_of, planar_fields, read_pose_track

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))  # for `tools.studies`

from tools import pruning_figure
from tools.camera import Camera, as_csv, filmed
from tools.studies.scoring import outline_errors, truth_of
from tools.studies.simulated import simulated

FIGURES = ROOT / "docs/figures"


def camera(path: Path) -> None:
    log, truth = simulated("rig", 3, 10.0)
    table = filmed(truth, log.rig.palm1_length, Camera(), np.random.default_rng(0))
    seen = (table["t_s"] < 41.0) | (table["t_s"] > 41.6)  # a gap, as from a hand in the picture
    with TemporaryDirectory() as folder:
        file = Path(folder) / "track.csv"
        file.write_text(as_csv(table, seen))
        track = read_pose_track(file)
    answer = reconstruct(log.events, log.rig)
    if answer.h is None or answer.touched is None:
        raise SystemExit(f"no outline: {answer.reason}")
    palms = [event for event in log.events if isinstance(event, PalmSample)]
    com = com_of(smoothed_path(palms, log.rig.palm_angle_noise).at(answer.t)[:, :2], answer.radii, log.rig)
    body = OutlineShape(answer.theta, answer.h, answer.touched.astype(float))
    result = PoseTrack("reconstruction", **planar_fields(answer.t, com[:, 0], com[:, 1], answer.psi, body=body))
    true = replace(track, body=OutlineShape(degrees(), np.array(truth["h_m"]), np.ones(360)))
    compare_figure.save([(compare(true, result), result.body, true.body)], path)


def pruning(path: Path) -> None:
    log, truth_line = simulated("odd", 67, 3.0)
    answer, truth = reconstruct(log.events, log.rig), truth_of(truth_line)
    errors = outline_errors(answer, truth)
    if errors is None:
        raise SystemExit(f"no outline: {answer.reason}")
    pruning_figure.save(answer, errors, truth.h, path)


def main() -> int:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FIGURES
    kind = sys.argv[2] if len(sys.argv) > 2 else "svg"
    camera(folder / f"camera.{kind}")
    pruning(folder / f"pruning.{kind}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
