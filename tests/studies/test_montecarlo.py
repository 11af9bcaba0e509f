"""The Monte Carlo study: the score of a run, the summary of many, independence of where they are executed."""

import dataclasses
import json
import math

import numpy as np
import pytest
from perfect_answer import NO_SHAPE, THETA, answer, simulator_truth, support

from palmd.events import Estimate, ShapeEstimate
from palmd.record.eventlog import read_log
from palmd.rig.simulate import simulate_log
from palmd.system.description import AS_CALIBRATED
from tools.studies import montecarlo
from tools.studies.bound import Bound
from tools.studies.montecarlo import STUDY, MonteCarloRow, MonteCarloTask, Scalar, row_of
from tools.studies.scoring import Causal, ObserverAnswers, causal_of, outline_errors, replayed, truth_of
from tools.studies.stub_observers import EmptyObserver

NAN = math.nan


TRUTH = truth_of(simulator_truth())
BOUND = Bound(np.full(360, 2e-5), 5e-4, 0.05, 0.005)


def scored(reconstruction, bound=BOUND, causal=None):
    return row_of(
        MonteCarloTask("friction", 3), TRUTH, reconstruction, outline_errors(reconstruction, TRUTH), bound, causal
    )


# --------------------------------------------------------------------------------------------------- scoring


def test_a_perfect_answer_has_no_errors_in_any_gauge():
    row = scored(answer())
    assert row.e_h_m < 1e-8
    assert row.max_error_m < 1e-7
    assert row.nees_h < 1e-5
    assert row.psi_rms_rad < 1e-6
    assert row.omega0_rms_rad_s < 1e-4
    assert row.rho_m == Scalar(0.014, 0.0, 1e-3, 5e-4)
    assert (row.kind, row.seed, row.converged, row.took_s) == ("friction", 3, True, 1.5)
    assert row.mean_radius_m == pytest.approx(0.02)
    assert row.right
    assert not row.wrong


def test_known_errors_are_measured():
    wave = 4e-5 * np.cos(12 * THETA)
    row = scored(answer(h=support(THETA + 0.7) + wave, touched=THETA >= 0.0, rho=0.0147, mu=0.15, mass=0.11))
    assert row.e_h_m == pytest.approx(4e-5 / math.sqrt(2), rel=1e-3)
    assert row.max_error_m == pytest.approx(4e-5, rel=1e-3)
    assert row.nees_h == pytest.approx(8.0, rel=1e-3)
    assert row.efficiency == pytest.approx(2e-5 / row.e_h_m)
    assert row.touched == 1.0
    assert row.rho_m.error == pytest.approx(7e-4)
    assert row.rho_m.relative_error == pytest.approx(0.05)
    assert (row.mu.error, row.mass_kg.error) == (pytest.approx(-0.05), pytest.approx(0.01))


def test_only_touched_normals_count():
    touched = THETA < 2.0
    bound = dataclasses.replace(BOUND, h_sd=np.where(touched, 3e-6, 1.0))
    row = scored(answer(h=np.where(touched, support(THETA + 0.7), NAN), h_sd=np.where(touched, 1e-5, 0.0)), bound)
    assert row.e_h_m < 1e-8
    assert row.nees_h < 1e-5
    assert row.h_bound_m == pytest.approx(3e-6)
    assert row.touched == touched.mean()


def test_the_bound_is_requested_at_the_truths_normals():
    errors = outline_errors(answer(), TRUTH)
    np.testing.assert_allclose(support(errors.true_theta), support(THETA + 0.7), atol=1e-8)
    assert 0.0 <= errors.true_theta.min() < errors.true_theta.max() < math.tau


def test_motion_is_compared_up_to_one_constant_and_whole_turns():
    wobble = 2e-3 * np.sin(50.0 * answer().t)
    psi = answer().psi + wobble
    wrapped = np.angle(np.exp(1j * (psi + 3.0)))
    assert np.abs(np.diff(wrapped)).max() > 6.0
    for given in (psi, psi - 20.0, wrapped):
        assert scored(answer(psi=given)).psi_rms_rad == pytest.approx(np.std(wobble), rel=1e-3)
    assert scored(answer(omega0=answer().omega0 + 0.3)).omega0_rms_rad_s == pytest.approx(0.3, rel=1e-3)


@pytest.mark.parametrize(
    "changes",
    [NO_SHAPE, {"touched": THETA > 7.0}, {"h": np.full(360, NAN)}],
    ids=["no shape", "nothing touched", "no numbers"],
)
def test_without_an_outline_its_scores_are_missing(changes):
    row = scored(answer(**changes))
    assert all(math.isnan(x) for x in (row.e_h_m, row.max_error_m, row.touched, row.efficiency, row.nees_h))
    assert not row.right
    assert not row.wrong
    assert row.rho_m.bound == 5e-4


def test_correct_and_wrong_rows():
    assert scored(answer(h=np.full(360, 0.02))).wrong
    assert not scored(answer(h=np.full(360, 0.02), converged=False)).wrong
    between = scored(answer(h=support(THETA + 0.7) + 2.8e-4 * np.cos(12 * THETA)))
    assert (between.right, between.wrong) == (False, False)


# ---------------------------------------------------------------------------------------------------- causal

TICKS = np.arange(1, 1001) * 0.01


def causal(**changes):
    """Valid from 1 s, everything correct from 2 s, r in error by one 1σ of 0.1 mm."""
    values = {
        "t": TICKS, "valid": TICKS > 0.995, "r_error": np.full((1000, 2), 1e-4), "r_sd": np.full((1000, 2), 1e-4),
        "e_h": np.where(TICKS > 1.995, 1e-4, NAN),
    }  # fmt: skip
    return causal_of(ObserverAnswers(**values | changes))


def test_convergence_requires_all_quantities_correct_to_the_end():
    score = causal()
    assert (score.converged_after_s, score.first_valid_s) == (pytest.approx(2.0), pytest.approx(1.0))
    assert (score.r_rms_m, score.nees_r) == (pytest.approx(1e-4), pytest.approx(1.0))
    off = np.full((1000, 2), 1e-4)
    off[499, 1] = -3.1e-4
    assert causal(r_error=off).converged_after_s == pytest.approx(5.01)
    assert causal(valid=(TICKS > 0.995) & (np.arange(1000) != 699)).converged_after_s == pytest.approx(7.01)
    assert causal(e_h=np.where(TICKS < 8.0, 2.1e-4, 1e-4)).converged_after_s == pytest.approx(8.0)
    assert causal(e_h=np.full(1000, 1e-4), valid=TICKS > 0.0).converged_after_s == pytest.approx(0.01)


def test_a_run_with_a_wrong_end_never_converged():
    for changes in ({"valid": TICKS < 9.0}, {"e_h": np.where(TICKS > 9.995, 3e-4, 1e-4)}, {"e_h": TICKS * NAN}):
        assert math.isnan(causal(**changes).converged_after_s)
    never = causal(valid=TICKS < 0.0)
    assert all(math.isnan(x) for x in (never.first_valid_s, never.r_rms_m, never.nees_r))


def test_only_valid_ticks_of_the_last_five_seconds_are_averaged():
    error = np.where((TICKS <= 5.0)[:, None], 1.0, [1e-4, 3e-4])
    error[TICKS > 9.0] = NAN
    score = causal(r_error=error, valid=(TICKS > 2.0) & (TICKS < 9.0))
    assert score.r_rms_m == pytest.approx(math.sqrt(5.0) * 1e-4)
    assert score.nees_r == pytest.approx(5.0)


class Oracle(EmptyObserver):
    """An observer that knows r1 and r2 to 0.1 mm from the first tick, and the outline from 0.6 s."""

    def __init__(self, truth, turn=0.4):
        self._truth, self._turn = truth, turn
        self.fed = []

    def feed(self, event):
        self.fed.append(event)

    def estimate(self, t):
        values = dict.fromkeys(Estimate.__dataclass_fields__, NAN)
        r1, r2 = (np.interp(t, self._truth["t"], self._truth[name]) for name in ("r1_m", "r2_m"))
        values |= {"t": t, "valid": t > 0.3, "r1": r1 + 1e-4, "r2": r2, "sd": {"r1": 2e-4, "r2": 2e-4, "omega0": NAN}}
        return Estimate(**values)

    def shape(self, t):
        if t < 0.35:
            return None
        h = np.interp(THETA + self._turn, THETA, self._truth["h_m"], period=math.tau)
        h = h if t > 0.55 else np.full(360, NAN)
        return ShapeEstimate(t, THETA, h, h, THETA < 3.0)


def log_of(tmp_path, kind="nominal", seed=1, seconds=1.0):
    lines, truth = simulate_log(kind, seed, seconds)
    path = tmp_path / "log.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return read_log(path), truth


def test_a_causal_replay_is_scored_tick_by_tick(tmp_path):
    log, truth = log_of(tmp_path)
    oracle = Oracle(truth)
    answers = replayed(log, truth, oracle)
    assert oracle.fed == list(log.events)
    assert answers.t == pytest.approx(np.arange(1, len(answers.t) + 1) * 0.01)
    np.testing.assert_allclose(answers.r_error, np.tile([1e-4, 0.0], (len(answers.t), 1)), atol=1e-9)
    score = causal_of(answers)
    assert score.first_valid_s == pytest.approx(0.31)
    assert score.converged_after_s == pytest.approx(0.6)
    assert score.nees_r == pytest.approx(0.125)


# ------------------------------------------------------------------------------------------------- the run


def test_a_run_is_scored_against_the_simulators_truth(tmp_path, monkeypatch):
    log, truth = log_of(tmp_path, "rig", 5)
    seen = {}

    def reconstruct(events, rig):
        seen["read"] = (events, rig)
        t = np.array(truth["t"])
        return answer(h=np.array(truth["h_m"]), psi=np.array(truth["psi_rad"]), omega0=t, t=t, rho=truth["rho_m"])

    def cramer_rao(events, rig, score, theta):
        seen["bound"] = (events, rig, score.rho, len(theta))
        return BOUND

    monkeypatch.setattr(montecarlo, "reconstruct", reconstruct)
    monkeypatch.setattr(montecarlo, "cramer_rao", cramer_rao)
    row = montecarlo.run(MonteCarloTask("rig", 5, 1.0, live=False))
    assert seen["read"] == (log.events, log.rig)
    assert seen["bound"] == (log.events, log.rig, truth["rho_m"], 360)
    assert row.error == ""
    assert row.e_h_m < 1e-8
    assert row.psi_rms_rad < 1e-9
    assert row.rho_m.error == 0.0
    assert row.causal is None


def test_the_live_observer_is_replayed_unless_disabled(monkeypatch):
    monkeypatch.setattr(montecarlo, "reconstruct", lambda *_: answer(**NO_SHAPE))
    monkeypatch.setattr(montecarlo, "cramer_rao", lambda *_: BOUND)
    row = montecarlo.run(MonteCarloTask("nominal", 1, 3.0))
    assert row.error == ""
    assert 0.3 < row.causal.first_valid_s <= row.causal.converged_after_s < 3.0
    assert row.causal.r_rms_m < 1e-4


def test_a_rig_may_have_residual_calibration_errors(monkeypatch):
    read = []
    monkeypatch.setattr(montecarlo, "reconstruct", lambda _, rig: read.append(rig) or answer(**NO_SHAPE))
    monkeypatch.setattr(montecarlo, "cramer_rao", lambda *_: BOUND)
    for word in ("none", "calibrated"):
        assert montecarlo.run(MonteCarloTask("nominal", 1, 1.0, False, word)).error == ""
    assert [rig.pads[0].zero_sd for rig in read] == [0.0, AS_CALIBRATED["zero_sd"]]


# ------------------------------------------------------------------------------------------------- summary


def row(kind="nominal", seed=0, e_h=1e-5, **changes):
    values = {
        "converged": True, "e_h_m": e_h, "max_error_m": 2 * e_h, "touched": 0.3, "efficiency": 0.5, "nees_h": 1.2,
        "rho_m": Scalar(0.02, -1e-3, 1e-3, 5e-4), "mu": Scalar(0.0, 0.1, 0.04, 0.02),
        "mass_kg": Scalar(0.1, 0.01, 4e-3, 0.0), "took_s": 2.0, "causal": Causal(3.0, 1.0, 1e-5, 0.9),
    }  # fmt: skip
    return MonteCarloRow(kind, seed, **values | changes)


FEW = [
    row(seed=0),
    row(seed=1, e_h=4e-4),
    row(seed=2, e_h=2e-4, causal=Causal(7.0, 5.0, 3e-5, 1.1)),
    row(seed=3, e_h=NAN, converged=False, max_error_m=NAN, causal=Causal(NAN, NAN, NAN, NAN)),
    MonteCarloRow("nominal", 4, error="ValueError: no"),
    row("odd", 0),
]


def cells_of(rows):
    lines = STUDY.tabled(rows).splitlines()
    width = max(len(title) for title, _ in STUDY.columns)
    return {line[:width].strip(): [cell for cell in line[width:].split("  ") if cell.strip()] for line in lines}


def test_the_table_has_a_column_for_each_kind_and_counts_every_run():
    cells = {name: [cell.strip() for cell in rest] for name, rest in cells_of(FEW).items()}
    assert cells[""] == ["nominal", "odd"]
    assert (cells["runs"], cells["ended in an error"]) == (["5", "1"], ["1", "0"])
    assert cells["right: e_h < 0.1 mm (%)"] == ["20.0", "100.0"]
    assert cells["converged (%)"] == ["60.0", "100.0"]
    assert cells["accepted but wrong: e_h > 0.3 mm"] == ["1", "0"]
    assert cells["e_h, median / p90 / p95 (µm)"] == ["400 / ∞ / ∞", "10 / 10 / 10"]
    assert cells["ρ: |error|, median (%)"] == ["5", "5"]
    assert cells["μ: |error|, median (%)"] == ["–", "–"]
    assert [cells[f"{name}: within 2 sd (%)"][0] for name in ("ρ", "μ", "mass")] == ["100.0", "0.0", "0.0"]
    assert (cells["ρ: sd / bound, median"][0], cells["mass: sd / bound, median"][0]) == ("2", "–")
    assert cells["live: converged after, median / p90 / p95 (s)"] == ["5 / ∞ / ∞", "3 / 3 / 3"]
    assert cells["live: within 6 s (%)"] == ["50", "100"]
    assert cells["live: first valid after, median (s)"] == ["1", "1"]


def test_remarks_name_failed_runs_and_a_wrong_run_misses_the_goal():
    assert STUDY.remarks(FEW) == ["nominal 1: accepted but wrong by 400 µm", "nominal 4: ValueError: no"]
    (goal,) = STUDY.goals
    assert not goal.met(FEW)
    assert goal.met(FEW[2:])
