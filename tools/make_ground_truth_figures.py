"""Draw docs/figures/camera.svg and pruning.svg from seeded simulated runs."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from palmd.events import PalmSample
from palmd.observer.reconstruct import Reconstruction, reconstruct
from palmd.outlinefile import Outline
from palmd.record.resultfile import Result
from palmd.record.track import read_track
from palmd.report import ground_truth_figure
from palmd.report.camera_frame import motion_of
from palmd.report.ground_truth import compare

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))  # for `tools.studies`

from tools import pruning_figure
from tools.camera import Camera, as_csv, filmed
from tools.studies.scoring import outline_errors, truth_of
from tools.studies.simulated import simulated

FIGURES = ROOT / "docs/figures"


def as_result(answer: Reconstruction) -> Result:
    if answer.h is None or answer.h_sd is None or answer.touched is None:
        raise SystemExit(f"no outline: {answer.reason}")
    return Result(
        answer.t, answer.psi, answer.radii, answer.theta, answer.h, answer.h_sd, answer.touched
    )  # fmt: skip


def camera(path: Path) -> None:
    log, truth = simulated("rig", 3, 10.0)
    table = filmed(truth, log.rig.palm1_length, Camera(), np.random.default_rng(0))
    seen = (table["t_s"] < 41.0) | (table["t_s"] > 41.6)  # a gap, as from a hand in the picture
    with TemporaryDirectory() as folder:
        file = Path(folder) / "track.csv"
        file.write_text(as_csv(table, seen))
        track = read_track(file)
    result = as_result(reconstruct(log.events, log.rig))
    palms = [event for event in log.events if isinstance(event, PalmSample)]
    nan = float("nan")
    outline = Outline("true", np.array(truth["h_m"]), np.zeros(360), truth["rho_m"], nan, nan, nan)
    found = compare(result, motion_of(result, log.rig, palms), track, outline)
    ground_truth_figure.save(result, found, outline, path)


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
