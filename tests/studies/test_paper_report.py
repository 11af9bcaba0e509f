"""The paper's runs again: what its method makes of them, what determines the beginning, the study paper."""

from __future__ import annotations

import json
import sys
from functools import cache

import numpy as np
import pytest

from palmd.rig.simulate import simulate_log
from tools import studies
from tools.studies import stable_pose_figures
from tools.studies.commands import main
from tools.studies.paper_published import HARDWARE, SIMULATION
from tools.studies.paper_report import HEAD, as_text, rows
from tools.studies.paper_runs import ASTRAY, paper_simulation, psi_error, relative_radius_error, side_by_side
from tools.studies.simulated import simulated


@cache
def simulation():
    return paper_simulation()


@cache
def side():
    return side_by_side("rig 404", *simulated("rig", 404, 6.0))


def test_the_papers_run_turns_far_without_a_jump_and_stays_on_the_pads():
    run = simulation().run
    assert len(run.t) == 270
    assert run.jumps == 0
    assert np.ptp(run.psi) > 5.0
    assert min(run.contacts.s1.min(), run.contacts.s2.min()) > 0.0
    assert max(run.contacts.s1.max(), run.contacts.s2.max()) < 0.0555
    assert run.contacts.v1.min() > 0.0


def test_exact_readings_and_the_conflict_give_shape_and_motion_where_the_search_began_far_off():
    found = simulation()
    true = float(found.run.contacts.r1[0] + found.run.contacts.r2[0]) / 2
    assert abs(found.circle - true) > 0.2 * true
    assert relative_radius_error(found.run, found.found) < 0.004 < SIMULATION.radius
    assert psi_error(found.run, found.found) < 0.03 < SIMULATION.psi_rad


def test_small_observable_errors_do_not_mean_a_correct_shape():
    found = simulation()
    valley, run = found.valley, found.run
    true = float(run.contacts.r1[0] + run.contacts.r2[0]) / 2
    assert np.ptp(valley.observable) < 0.05 * valley.observable.mean()
    assert valley.observable.max() < 2e-5
    assert abs(valley.mean[np.argmin(valley.conflict)] - true) < 2 * (valley.mean[1] - valley.mean[0])
    assert valley.conflict.max() > 5 * valley.conflict.min()
    off = relative_radius_error(run, found.astray)
    assert off > ASTRAY / 2
    assert np.sqrt(np.mean(found.astray.e_f**2 + found.astray.e_c**2)) < 2e-5


def test_on_the_emulated_rig_the_smoother_is_better_by_orders_of_magnitude():
    both = side()
    assert both.quasistatic is not None
    assert both.smoother is not None
    assert both.smoother.score.e_h < 1e-4 < both.quasistatic.score.e_h < 5e-3
    assert both.smoother.psi_rms < 0.01 < both.psi_still
    trace = both.quasistatic.trace
    true = [np.interp(trace.t, both.told["t"], both.told[name]) for name in ("r1_m", "r2_m")]
    assert both.quasistatic.r_rms == pytest.approx(np.sqrt(np.mean((np.stack([trace.r1, trace.r2]) - true) ** 2)))


def test_the_table_has_the_papers_errors_beside_those_measured():
    table = rows(simulation(), [side()])
    text = as_text(table)
    assert all(len(row) == len(HEAD) for row in table)
    assert f"{SIMULATION.psi_rad:.4f} rad" in text
    assert f"{HARDWARE.rms_mm:g} mm" in text
    assert [row[1] for row in table[-3:]] == ["it does not turn", "quasistatic", "reconstruct"]


def test_a_method_without_an_answer_says_so():
    log, told = simulated("rig", 404, 1.2)
    table = rows(simulation(), [side_by_side("short", log, told)])
    assert table[-2][2] == "no answer"


def test_the_command_prints_the_table_and_saves_the_figures(tmp_path, capsys, monkeypatch):
    lines, told = simulate_log("friction", 405, 4.0)
    log = tmp_path / "run.jsonl"
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    (tmp_path / "run.truth.json").write_text(json.dumps(told))
    folder = tmp_path / "figures"
    assert main(["paper", str(log), "-o", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "quasistatic" in printed
    assert {path.name for path in folder.iterdir()} == {
        *("paper_frames.svg", "paper_simulation.svg", "paper_experiment.svg"),
        *("stable_poses.svg", "ambiguous.svg"),
    }
    (again := tmp_path / "again").mkdir()
    for path in stable_pose_figures.save(again):  # drawn alike each time, and small enough to be kept
        drawn = path.read_bytes()
        assert drawn == (folder / path.name).read_bytes()
        assert 1e4 < len(drawn) < 4e5


def test_bad_input_is_one_line(tmp_path, capsys, monkeypatch):
    lines, told = simulate_log("friction", 405, 1.0)
    log = tmp_path / "run.jsonl"
    assert main(["paper", str(log)]) == 1
    assert "run.jsonl" in capsys.readouterr().err
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    truth = tmp_path / "run.truth.json"
    for text, said in ((None, "needs each log's truth"), ("{", "not JSON"), ("[]", "no truth"), ("{}", "psi_rad")):
        if text is not None:
            truth.write_text(text)
        assert main(["paper", str(log)]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert said in error
    truth.write_text(json.dumps(told))
    for module in ("paper_figures", "stable_pose_figures"):
        monkeypatch.delitem(sys.modules, f"tools.studies.{module}", raising=False)
        monkeypatch.delattr(studies, module, raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["paper", str(log)]) == 1
    assert "matplotlib" in capsys.readouterr().err
