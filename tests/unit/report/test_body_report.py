"""The report of a body in space: figures from four sides if it converged, otherwise the reason."""

import gzip
import json

import numpy as np
import pytest

from palmd.cli import main
from palmd.model.icosphere import icosphere
from palmd.report.body_report import body_report, first_view
from palmd.report.html import as_html


@pytest.fixture
def result():
    """A ball of 20 mm, touched from above."""
    directions, triangles = icosphere(2)
    K = 5
    curve = 0.02 * np.stack([np.sin(0.1 * np.arange(K)), np.zeros(K), np.cos(0.1 * np.arange(K))], axis=1)
    return {
        "converged": True, "reason": None, "chi2": 1.0, "directions": directions.tolist(),
        "triangles": triangles.tolist(), "h_m": [0.02] * len(directions), "h_sd_m": [1e-5] * len(directions),
        "touched": (directions[:, 2] > 0.8).astype(int).tolist(), "points_m": (0.02 * directions).tolist(),
        "inertia_m2": (1.6e-4 * np.eye(3)).tolist(), "inertia_sd_m2": (1.6e-5 * np.eye(3)).tolist(),
        "mu": 0.1, "mu_sd": 0.001, "mass_kg": 0.05, "mass_sd_kg": 1e-4,
        "trajectory": {
            "t": np.arange(K).tolist(), "quat_xyzw": [[0.0, 0.0, 0.0, 1.0]] * K, "omega_rad_s": [[0.0] * 3] * K,
            "com_m": [[0.0] * 3] * K, "contacts_body_m": np.stack([curve] * 3, axis=1).tolist(),
        },
    }  # fmt: skip


def test_a_converged_result_is_drawn(result):
    page = as_html(body_report("ball", result))
    assert page.count("<figure>") == 2
    assert "10 µm RMS" in page
    assert "50.00 ± 0.10 g" in page


def test_a_result_that_did_not_converge_gives_its_reason(result):
    page = as_html(body_report("ball", result | {"converged": False, "reason": "it rolled away", "trajectory": None}))
    assert "not converged: it rolled away" in page
    assert "<figure>" not in page


def test_the_first_view_is_of_the_touched_side(result):
    view = first_view(np.array(result["trajectory"]["contacts_body_m"]))
    np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(view) == pytest.approx(1.0)
    assert view[2, 2] > 0.9


@pytest.mark.parametrize("name", ["run.jsonl", "run.jsonl.gz"])
def test_a_log_of_two_palms_has_no_such_report(tmp_path, capsys, name):
    path, lines = tmp_path / name, (json.dumps({"palmd_log": 1, "rig": {}}) + "\n").encode()
    path.write_bytes(gzip.compress(lines) if path.suffix == ".gz" else lines)
    assert main(["report", str(path), "-o", str(tmp_path / "report.html")]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "run.jsonl" in said
    assert "MCAP" not in said
