"""The paper's runs again: what its method makes of them, what determines the beginning, the study paper."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

from palmd.rig.simulate import simulate_log
from tools.studies import paper
from tools.studies.commands import main
from tools.studies.paper import HARDWARE_RMS_M, PUBLISHED_PSI_RAD, PUBLISHED_RADIUS, STUDY, PaperTask
from tools.studies.paper_runs import RADIUS_ERROR, paper_simulation, psi_error, relative_radius_error


@cache
def simulation():
    return paper_simulation()


@cache
def row():
    return paper.run(PaperTask("", "rig", 404, 6.0))


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
    assert relative_radius_error(found.run, found.found) < 0.004 < PUBLISHED_RADIUS
    assert psi_error(found.run, found.found) < 0.03 < PUBLISHED_PSI_RAD


def test_small_observable_errors_do_not_mean_a_correct_shape():
    found = simulation()
    valley, run = found.valley, found.run
    true = float(run.contacts.r1[0] + run.contacts.r2[0]) / 2
    assert np.ptp(valley.observable) < 0.05 * valley.observable.mean()
    assert valley.observable.max() < 2e-5
    assert abs(valley.mean[np.argmin(valley.conflict)] - true) < 2 * (valley.mean[1] - valley.mean[0])
    assert valley.conflict.max() > 5 * valley.conflict.min()
    off = relative_radius_error(run, found.wrong_radius)
    assert off > RADIUS_ERROR / 2
    assert np.sqrt(np.mean(found.wrong_radius.e_f**2 + found.wrong_radius.e_c**2)) < 2e-5


def test_on_the_emulated_rig_the_smoother_is_better_by_orders_of_magnitude():
    both = row()
    assert both.smoother.e_h_m < 1e-4 < both.quasistatic.e_h_m < 5e-3
    assert both.smoother.psi_rad < 0.01 < both.psi_still
    assert both.smoother.r_m < 1e-4 < both.quasistatic.r_m
    assert both.quasistatic.of_radius == pytest.approx(both.quasistatic.e_h_m / 0.02, rel=0.3)


def test_the_table_has_the_papers_errors_beside_those_measured():
    lines = STUDY.report([row()]).splitlines()
    assert f"{PUBLISHED_PSI_RAD:.4f} rad" in lines[1]
    assert f"{HARDWARE_RMS_M * 1e3:.3f} mm" in lines[5]
    assert [line.split("  ")[0] for line in lines[-3:]] == ["rig 404"] * 3
    assert ["does not turn" in lines[-3], "quasistatic" in lines[-2], "reconstruct" in lines[-1]] == [True] * 3


@pytest.mark.nightly
def test_a_method_without_an_answer_says_so():
    short = paper.run(PaperTask("", "rig", 404, 1.2))
    assert "no estimate" in STUDY.report([short]).splitlines()[-2]


@pytest.mark.nightly
def test_the_command_takes_logs_with_their_truth(tmp_path, capsys):
    lines, truth = simulate_log("friction", 405, 4.0)
    log = tmp_path / "run.jsonl"
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    (tmp_path / "run.truth.json").write_text(json.dumps(truth))
    assert main(["paper", str(log), "--jobs", "1", "-o", str(tmp_path / "rows.jsonl")]) == 0
    assert "run  " in capsys.readouterr().out
    (line,) = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert line["error"] == ""
    assert line["smoother"]["e_h_m"] < 1e-3


def test_bad_input_is_one_line(tmp_path, capsys):
    lines, _ = simulate_log("friction", 405, 1.0)
    log = tmp_path / "run.jsonl"
    assert main(["paper", str(log)]) == 1
    assert "run.jsonl" in capsys.readouterr().err
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    for text, said in (
        (None, "needs each log's truth"),
        ("{", "not JSON"),
        ("[]", "not a truth file"),
        ("{}", "psi_rad"),
    ):
        if text is not None:
            (tmp_path / "run.truth.json").write_text(text)
        assert main(["paper", str(log)]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert said in error
