"""Simulation-based calibration: statistics with known results, the row of a run, resumed files."""

import json
import math

import numpy as np
import pytest
from perfect_answer import NO_SHAPE, THETA, answer, simulator_truth, support
from scipy import stats

from palmd.model.shape import basis
from palmd.observer import prior
from palmd.observer.first_guess import LN_GYRATION_SD
from palmd.observer.outline import gauge_free_sd
from palmd.rig.imperfections import drawn
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.reasons import Code, Reason
from palmd.system.rig_constants import RIG_NAMES, prior_sds
from tools.studies import sbc
from tools.studies.sbc import (
    CONSTANTS,
    DRAWN,
    STUDY,
    TOGETHER,
    MarginalPosterior,
    SbcRow,
    SbcTask,
    far,
    gauge_free_error,
    report,
    row_from,
    row_of,
    uniformities,
    wrong,
)
from tools.studies.uniformity import Uniformity, at_most, non_uniform

TASK = SbcTask("friction", 3, 10.0)
EVEN = stats.norm.ppf((np.arange(1000) + 0.5) / 1000)

RIG = len(RIG_NAMES)


# ------------------------------------------------------------------------------------------------ statistics


def test_z_of_evenly_spaced_ranks_is_uniform_to_half_a_step():
    result = Uniformity.of(EVEN)
    assert result.distance == pytest.approx(0.5 / 1000)
    assert (result.runs, result.mean, result.sd) == (1000, pytest.approx(0.0, abs=1e-12), pytest.approx(1.0, abs=0.01))
    assert result.within == pytest.approx((0.683, 0.954, 0.997), abs=0.0011)
    assert result.p > 0.999


def accepted_row(z, seed=0, **changes):
    return SbcRow(
        "rig", seed, 10.0, converged=True, rig_distance2=15.0, beliefs={"mu": MarginalPosterior(z, 0.0, 1.0)}, **changes
    )


def study(z):
    """Statistics of posteriors about 0 with 1σ of 1, one for each of these truths."""
    return uniformities([accepted_row(float(each), seed) for seed, each in enumerate(z)])


@pytest.mark.parametrize(
    ("z", "expected"),
    [(EVEN, []), (EVEN / 0.8, ["mu"]), (EVEN * 0.8, ["mu"]), (EVEN + 0.2, ["mu"])],
    ids=["correct", "1σ a quarter too small", "1σ too large", "biased by a fifth"],
)
def test_only_correct_standard_deviations_give_uniform_ranks(z, expected):
    assert non_uniform({"mu": study(z)["mu"]}) == expected


def test_the_rigs_constants_are_tested_together_too():
    random = np.random.default_rng(5)
    distances = np.sum(random.standard_normal((2000, len(CONSTANTS))) ** 2, axis=1)
    for scale, right in ((1.0, True), (1.1**2, False)):
        rows = [SbcRow("rig", i, 10.0, converged=True, rig_distance2=d * scale) for i, d in enumerate(distances)]
        result = uniformities(rows)
        assert (TOGETHER not in non_uniform(result)) == right
    assert result[TOGETHER].mean > 0.2


def test_rejected_runs_and_missing_values_do_not_count():
    rows = [
        accepted_row(0.5),
        accepted_row(math.nan, 1),
        SbcRow("rig", 2, 10.0, beliefs={"mu": MarginalPosterior(9.0, 0.0, 1.0)}),
    ]
    assert uniformities(rows)["mu"].runs == 1


def test_errors_that_make_an_accepted_estimate_wrong():
    assert not far(accepted_row(5.9, worst_z=5.9))
    assert far(accepted_row(-6.1)) == ["mu"]
    assert far(accepted_row(0.0, worst_z=6.1)) == ["a touched normal"]
    assert (wrong(accepted_row(0.0, beyond_m=3.1e-4)), wrong(accepted_row(0.0, beyond_m=2.9e-4))) == (True, False)


def test_a_count_gives_its_upper_confidence_limit():
    assert at_most(0, 300) == pytest.approx(1 - 0.05 ** (1 / 300))
    assert at_most(2, 10) == pytest.approx(0.5069, abs=1e-4)  # Clopper and Pearson's table
    assert at_most(4, 4) == 1.0


def test_the_report_gives_seeds_counts_and_suspicious_runs():
    rows = [accepted_row(float(z), seed, worst_z=1.0, beyond_m=0.0) for seed, z in enumerate(EVEN)]
    rows += [
        SbcRow("rig", 1001, 10.0, reason="too little"),
        SbcRow("rig", 1002, 10.0, error="ValueError: no ground"),
        accepted_row(7.0, 1003, beyond_m=4e-4, contradicted={"phi2_rad": 4.7}),
    ]
    text = report(rows)
    assert "rig: seeds 0–999, 1001–1003\n" in text
    assert "  accepted: 1001 of 1003\n" in text
    assert "not accepted: 1: too little\n" in text
    assert "0.3 mm beyond its band: 1 of 1001 (at most 0.47 %" in text
    assert STUDY.remarks(rows) == [
        "rig 1002: ValueError: no ground",
        "rig 1003: accepted, error 0.40 mm beyond its band",
        "rig 1003: accepted, errors above 6 sd: mu",
        "rig 1003: contradicted: phi2_rad (+4.7 sd)",
    ]
    (goal,) = STUDY.goals
    assert (goal.met(rows), goal.met(rows[:-1])) == (False, True)
    (line,) = [line for line in text.splitlines() if line.startswith("mu ")]
    assert not line.endswith("not uniform")


def test_several_kinds_are_also_reported_together():
    rows = [
        SbcRow("nominal", seed, 10.0, converged=True, beliefs={"mu": MarginalPosterior(0.5, 0.0, 1.0)})
        for seed in (1, 2)
    ]
    assert "all kinds" not in report(rows)
    assert "all kinds: seeds 1–3\n  accepted: 3 of 3\n" in report([*rows, accepted_row(0.1, 3)])


def test_imperfections_are_drawn_from_the_priors_of_reconstruct():
    """Ranks of unobservable constants are uniform only in this case."""
    rig = RigDescription().known_to(AS_CALIBRATED)
    true = [drawn(rig, 1, seed).constants() for seed in range(3000)]
    z = np.array([[each[name] for name in CONSTANTS] for each in true]) / prior_sds(rig)[DRAWN]
    assert non_uniform({name: Uniformity.of(column) for name, column in zip(CONSTANTS, z.T, strict=True)}) == []


def test_friction_and_motion_of_an_object_are_drawn_from_the_priors_of_reconstruct():
    drawn = [sbc.drawn_from_prior("friction", seed) for seed in range(400)]
    z = {
        "rho": [
            math.log(body.rho / body.support.sample(THETA).mean() / prior.GYRATION) / LN_GYRATION_SD
            for body, _ in drawn
        ],
        "dither": [math.log(surface.dither / prior.DITHER) / prior.LN_DITHER_SD for _, surface in drawn],
    }
    assert non_uniform({name: Uniformity.of(np.array(each)) for name, each in z.items()}) == []
    friction = np.array([surface.mu for _, surface in drawn])
    assert friction.min() > 0.0
    assert np.median(friction) == pytest.approx(0.12, abs=0.015)  # of a Gaussian about 0.1 without its negative part
    assert sbc.drawn_from_prior("nominal", 1)[1] is None
    assert sbc.drawn_from_prior("rig", 1)[0] == sbc.drawn_from_prior("rig", 1)[0]


# ------------------------------------------------------------------------------------------------------ runs


def test_a_perfect_answer_agrees_with_the_truth_in_any_gauge():
    row = row_of(TASK, simulator_truth(), answer())
    assert (row.kind, row.seed, row.seconds) == (TASK.kind, TASK.seed, TASK.seconds)
    assert row.converged
    assert row.e_h_m < 1e-8
    assert row.rig_distance2 == 0.0
    assert row.contradicted == {}
    assert {*CONSTANTS, "ln_rho", "ln_mass", "mu", "turned_rad", "h_touched_1_m", "h_untouched_8_m"} < {*row.beliefs}
    assert max(abs(belief.z) for belief in row.beliefs.values()) < 1e-2


def test_an_outline_part_that_fits_only_after_a_rotation_is_wrong():
    """The score finds the best rotation of the whole; the part contradicts the estimated ψ."""
    row = row_of(TASK, simulator_truth(), answer(h=support(THETA + 1.0), psi=answer().psi))
    assert row.best_e_h_m < 1e-8
    assert row.e_h_m > 1e-5
    assert far(row)


def test_a_small_rotation_of_the_whole_outline_is_no_error():
    turned = support(THETA + 0.7 + 1e-3)
    assert np.abs(turned - support(THETA + 0.7)).max() > 1e-6
    assert np.abs(gauge_free_error(THETA, turned, support(THETA), 0.7, THETA < 2.0)).max() < 5e-9


def test_the_errors_standard_deviation_is_that_of_reconstruct():
    """Outlines with an error along one column of the covariance's root: band by `observer.outline`, error by this
    study.
    """
    order, random = 5, np.random.default_rng(2)
    mean = np.array([0.02, 0.0, 0.0, 8e-4, 2e-4, 3e-4, 1e-4, 5e-5, 4e-5, 3e-5, 2e-5])
    root = 1e-6 * random.standard_normal((len(mean), len(mean)))
    touched = THETA < 2.0
    h_sd = gauge_free_sd(THETA, THETA[touched], mean, root @ root.T)
    h = basis(THETA, order) @ mean
    off = np.array([gauge_free_error(THETA, h, h + basis(THETA, order) @ each, 0.0, touched) for each in root.T])
    np.testing.assert_allclose(np.sqrt((off**2).sum(axis=0)) / h_sd, 1.0, atol=0.01)


def test_known_z_are_measured():
    wave = 4e-5 * np.cos(24 * THETA)
    off = answer(
        h=support(THETA + 0.7) + wave, rho=0.013, mu=0.25, mass=0.098, psi=answer().psi + 2e-3 * answer().t,
        rig=np.linspace(-1.0, 1.0, RIG), rig_covariance=np.diag(np.arange(1.0, RIG + 1.0) ** 2),
        contradicted=5.0 * (np.arange(RIG) == 11),
    )  # fmt: skip
    row = row_of(TASK, simulator_truth(), off)
    assert row.beliefs["ln_rho"].z == pytest.approx(math.log(14 / 13) * 13.0)
    assert row.beliefs["ln_mass"].z == pytest.approx(math.log(100 / 98) * 9.8)
    assert row.beliefs["mu"].z == pytest.approx(-0.5)
    assert row.beliefs["turned_rad"].z == pytest.approx(-2.0 * np.ptp(off.t), rel=1e-3)
    off_by = (np.linspace(-1, 1, RIG) / np.arange(1, RIG + 1))[DRAWN]
    assert [row.beliefs[name].z for name in CONSTANTS] == pytest.approx(-off_by)
    assert row.rig_distance2 == pytest.approx(np.sum(off_by**2))
    assert (row.e_h_m, row.h_sd_m) == (pytest.approx(4e-5 / math.sqrt(2), rel=0.02), pytest.approx(1e-5))
    assert (row.worst_z, row.beyond_m) == (pytest.approx(4.0, rel=0.02), pytest.approx(3e-5, rel=0.03))
    assert row.contradicted == {"phi2_rad": 5.0}


def test_touched_and_untouched_normals_are_both_scored():
    row = row_of(TASK, simulator_truth(), answer(h_sd=np.where(THETA < 2.0, 1e-5, 1e-3)))
    sds = {
        name: {b.sd for key, b in row.beliefs.items() if key.startswith(f"h_{name}_")}
        for name in ("touched", "untouched")
    }
    assert sds == {"touched": {1e-5}, "untouched": {1e-3}}


def test_without_friction_or_outline_there_is_no_score_of_it():
    assert "mu" not in row_of(TASK, simulator_truth(mu=0.0, dither_m_s=None), answer()).beliefs
    row = row_of(TASK, simulator_truth(), answer(**NO_SHAPE, reason=Reason(Code.UNDETERMINED, "too little")))
    assert (row.converged, row.reason, row.beliefs) == (False, "too little", {})


def test_a_line_holds_the_whole_row():
    for row in (
        row_of(TASK, simulator_truth(), answer(turned_sd=math.nan)),
        sbc.SbcRow("rig", 3, 10.0, error="ValueError: no ground"),
    ):
        line = json.loads(json.dumps(STUDY.as_line(row), allow_nan=False))
        assert STUDY.as_line(row_from(line)) == STUDY.as_line(row)


@pytest.mark.nightly
def test_a_small_study_of_real_runs():
    """Too small for ranks of one quantity, but a wrong sign, unit or order, or 1σ a third too small, are found."""
    rows = [sbc.run(SbcTask(kind, seed, 4.0)) for kind in ("friction", "rig") for seed in (5, 6, 7)]
    assert [row.error for row in rows] == [""] * len(rows)
    accepted = [row for row in rows if row.converged]
    assert len(accepted) >= 5
    prior_sd = prior_sds(RigDescription().known_to(AS_CALIBRATED))[DRAWN]
    for row in accepted:
        assert far(row, 4.0) == []
        assert not row.contradicted
        true, sd = ([getattr(row.beliefs[name], what) for name in CONSTANTS] for what in ("true", "sd"))
        assert (np.abs(true) > 0.0).all()
        assert (np.abs(true) <= 3.0 * math.sqrt(2.0) * prior_sd).all()
        wider = np.array(sd) > 1.01 * prior_sd  # inflated because of a doubtful rig: few constants
        assert wider.mean() < 0.25
        assert (np.array(sd) <= 1.5 * prior_sd).all()
    together = stats.chi2(len(CONSTANTS) * len(accepted))
    assert together.ppf(1e-3) < sum(row.rig_distance2 for row in accepted) < together.ppf(1.0 - 1e-3)
