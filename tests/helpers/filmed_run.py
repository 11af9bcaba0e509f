"""A run's log, its truth and its reconstruction, and a camera's track of it: made once."""

import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from palmd.cli import main
from palmd.rig.simulate import simulate_log
from tools.camera import Camera, as_csv, filmed

CAMERA = Camera()
_KEPT = TemporaryDirectory(prefix="palmd-test-film-")


@cache
def made():
    """The folder of the files, and the track as a table."""
    path = Path(_KEPT.name)
    lines, truth = simulate_log("rig", 3, 6.0)
    (path / "run.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (path / "truth.json").write_text(json.dumps(truth))
    table = filmed(truth, lines[0]["rig"]["hinge"]["palm1_length_m"], CAMERA, np.random.default_rng(0))
    (path / "track.csv").write_text(as_csv(table))
    assert main(["reconstruct", str(path / "run.jsonl"), "-o", str(path / "result.json")]) == 0
    return path, table
