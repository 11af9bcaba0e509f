"""The pivoting grasp from log to result: reading, results, and errors."""

import json
from functools import partial

import numpy as np
import pytest

import palmd
from palmd.cli import main
from palmd.observer.pivot.incremental import SimulatedSmoothing
from palmd.record.systems import pivot, read_log_of_any
from palmd.score import score_outline
from palmd.system.pivot import GripperSample, PivotRig
from tools.studies.pivot_logs import simulate_pivot_log

FIELDS = {
    *("verdict", "converged", "coverage", "chi2", "theta_rad", "hP_m", "hP_sd_m", "touched", "mu", "mu_sd"),
    *("com_from_pivot_m", "com_from_pivot_sd_m", "inertia_pivot_m2", "inertia_pivot_sd_m2", "trajectory", "seconds"),
}


def written(path, lines):
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def reconstructed(kind, folder):
    """A log, its truth, and the result of the command."""
    lines, truth = simulate_pivot_log(kind, 3)
    log, out = written(folder / "log.jsonl", lines), folder / "out.json"
    assert main(["reconstruct", str(log), "-o", str(out)]) == 0
    return log, truth, json.loads(out.read_text())


@pytest.fixture(scope="module")
def tilt(tmp_path_factory):
    return reconstructed("tilt", tmp_path_factory.mktemp("tilt"))


@pytest.fixture(scope="module")
def float_(tmp_path_factory):
    return reconstructed("float", tmp_path_factory.mktemp("float"))


@pytest.fixture(params=["tilt", "float_"])
def run(request):
    return request.getfixturevalue(request.param)


def test_the_result_has_the_documented_fields_and_agrees_with_the_truth(run):
    _, truth, result = run
    assert set(result) > FIELDS
    assert result["converged"] is True
    theta, h, touched = (np.array(result[name]) for name in ("theta_rad", "hP_m", "touched"))
    assert len(theta) == len(h) == len(touched) == 360
    score = score_outline(theta, h, touched == 1, np.array(truth["hP_m"]))
    assert score.e_h < 3e-5
    assert abs(result["mu"] - truth["mu"]) < 3 * result["mu_sd"]
    trajectory = result["trajectory"]
    assert len({len(column) for column in trajectory.values()}) == 1
    assert trajectory["psi_rad"][0] == pytest.approx(0.0, abs=1e-4)
    true = np.interp(trajectory["t"], truth["t"], truth["psi_rad"])
    off = (np.array(trajectory["psi_rad"]) - true + np.pi) % (2 * np.pi) - np.pi
    assert np.percentile(np.abs(off), 98) < 0.02  # except where the truth, sampled every 9 ms, jumps between touches


def test_only_a_slide_determines_the_mass(run):
    _, truth, result = run
    if truth["kind"] == "tilt":
        assert result["com_from_pivot_m"] is result["inertia_pivot_m2"] is result["mass_kg"] is None
        assert "mass" in result["unobservable"][0]
        return
    assert result["unobservable"] == result["not_told"] == []
    assert result["mass_kg"] == pytest.approx(truth["mass_kg"], abs=4 * result["mass_sd_kg"])
    sd = np.array(result["com_from_pivot_sd_m"])
    assert (np.abs(np.array(result["com_from_pivot_m"]) + truth["pivot_m"]) < 4 * sd + 1e-4).all()


def test_the_library_agrees_with_the_command(tilt):
    log, _, result = tilt
    answer = palmd.reconstruct(log)
    assert (answer.system, answer.converged) == ("pivot", True)
    assert answer.results["hP_m"] == result["hP_m"]
    assert answer.trajectory["psi_rad"].tolist() == result["trajectory"]["psi_rad"]
    with pytest.raises(palmd.PalmdError, match="no outline: the results of the system pivot"):
        answer.outline_xy()


def test_estimates_of_a_log_are_those_of_the_daemon(tilt, tmp_path, monkeypatch):
    log, truth, _ = tilt
    monkeypatch.setattr(pivot, "SimulatedSmoothing", partial(SimulatedSmoothing, period_s=4.0))  # the slow part
    out = tmp_path / "out.jsonl"
    assert main(["estimate", str(log), "-o", str(out)]) == 0
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    ticks, shapes = ([line for line in lines if name in line] for name in ("z_m", "shape"))
    assert sum(tick["valid"] for tick in ticks) > 100
    assert all(tick["valid"] or tick["reason"] for tick in ticks)
    shape = shapes[-1]["shape"]
    theta, h, touched = (np.array(shape[name]) for name in ("theta_rad", "hP_m", "touched"))
    assert score_outline(theta, h, touched == 1, np.array(truth["hP_m"])).e_h < 1e-4


def test_the_outline_is_exported_for_cad(tilt, tmp_path):
    out = tmp_path / "out.svg"
    assert main(["reconstruct", str(tilt[0]), "-o", str(out)]) == 0
    assert "<svg" in out.read_text()


@pytest.fixture(scope="module")
def lines():
    return simulate_pivot_log("tilt", 3)[0]


def test_a_log_is_read(lines, tmp_path):
    system, log = read_log_of_any(written(tmp_path / "log.jsonl", lines))
    assert system.name == "pivot"
    assert isinstance(log.rig, PivotRig)
    assert (log.rig.vertical, log.rig.arm_noise, log.rig.pad.zero_sd) == ("rigid", 2e-5, 0.0)
    arm = next(line["arm"] for line in lines if "arm" in line)
    first = next(event for event in log.events if isinstance(event, GripperSample))
    assert (first.x, first.z, first.vz) == (arm["x_m"], arm["z_m"], arm["vz_m_s"])
    del lines[0]["rig"]["calibration_sd"]
    _, log = read_log_of_any(written(tmp_path / "log.jsonl", lines))
    assert log.rig.pad.zero_sd == 1e-4  # as calibrated


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"gripper": {"vertical": "soft"}}, 'gripper.vertical must be rigid or float, got "soft"'),
        ({"gripper": {"vertical": "float"}}, "carriage_mass_kg is missing"),
        ({"gripper": {"vertical": "rigid", "z_measured": 1}}, "gripper.z_measured must be true or false, got 1"),
        ({"pad": None}, "pad is missing"),
    ],
)
def test_an_invalid_header_is_rejected(change, said, lines, tmp_path, capsys):
    header = lines[0] | {"rig": lines[0]["rig"] | change}
    log = written(tmp_path / "log.jsonl", [header, *lines[1:50]])
    assert main(["reconstruct", str(log), "-o", str(tmp_path / "out.json")]) == 1
    assert capsys.readouterr().err == f"{log}:1: {said}\n"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ({"t": 0.1, "pad": 2, "s_m": 0.02}, "pad must be 1, as a pivoting grasp has one pad; got 2"),
        ({"t": 0.1, "pad": 1, "s_m": 20.0}, "s_m is 20, not a position on a pad; the unit is metres"),
        ({"t": 0.1, "arm": {"x_m": 0.01, "z_m": 20.0}}, "z_m is 20, not a position near a pad; the unit is metres"),
        ({"t": 0.1, "arm": {"z_m": 0.02}}, "x_m is missing"),
    ],
)
def test_an_invalid_event_is_rejected(line, said, lines, tmp_path, capsys):
    log = written(tmp_path / "log.jsonl", [lines[0], line, *lines[1:50]])
    assert main(["reconstruct", str(log), "-o", str(tmp_path / "out.json")]) == 1
    assert capsys.readouterr().err == f"{log}:2: {said}\n"
