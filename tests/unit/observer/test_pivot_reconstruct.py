"""Reconstruction of a pivoting grasp: tolerated errors, rejections with their reasons, and its parts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from system_logs import log_of

from palmd.events import PadSample
from palmd.model.pivot import P
from palmd.observer.pivot.arm_path import axis_path
from palmd.observer.pivot.reconstruct import reconstruct
from palmd.observer.pivot.record import TouchSpan, arm_motion, lay_out
from palmd.observer.pivot.starts import outline_through, prior_of, rigid_starts, side_of, turned
from palmd.record.systems.pivot import SYSTEM
from palmd.score import score_outline
from palmd.system.pivot import GripperSample
from palmd.system.reasons import Code
from tools.studies.pivot_logs import PivotImperfections, simulate_pivot_log

SEED = 3


def run_of(kind, seed=SEED, **changes):
    """Rig, events and truth of a simulated run."""
    lines, truth = simulate_pivot_log(kind, seed, **changes)
    log = log_of(SYSTEM, lines)
    return log.rig, list(log.events), truth


@pytest.fixture(scope="module")
def tilt():
    return run_of("tilt")


@pytest.fixture(scope="module")
def slide():
    return run_of("float")


def arms(events, change):
    return [change(each) if isinstance(each, GripperSample) else each for each in events]


def pads(events, change):
    return [change(each) if isinstance(each, PadSample) else each for each in events]


def error_of(answer, truth):
    assert answer.converged, answer.reason
    return score_outline(answer.theta, answer.h, answer.touched, np.array(truth["hP_m"])).e_h


# ------------------------------------------------------------------------------------------------ what is tolerated


@pytest.mark.nightly
@pytest.mark.parametrize(
    "off", [PivotImperfections(outliers=0.1), PivotImperfections(gaps=4), PivotImperfections(noise=2.0)], ids=repr
)
def test_outliers_gaps_and_noise_are_tolerated(off):
    rig, events, truth = run_of("tilt", flaws=off)
    assert error_of(reconstruct(events, rig), truth) < 6e-5


def test_positions_without_a_plan_are_sufficient(tilt):
    rig, events, truth = tilt
    bare = arms(events, lambda arm: replace(arm, vx=None, ax=None, vz=None, az=None))
    assert error_of(reconstruct(bare, rig), truth) < 6e-5


def test_bands_are_wider_on_a_less_well_known_rig(tilt):
    rig, events, truth = tilt
    sure = reconstruct(events, rig)
    doubting = reconstruct(events, rig.known_to({"standoff_sd": 2e-4}))
    assert error_of(doubting, truth) < 6e-5
    wider = np.median(doubting.h_sd[doubting.touched]) / np.median(sure.h_sd[sure.touched])
    assert wider > 4.0
    assert np.median(doubting.h_sd[doubting.touched]) == pytest.approx(2e-4, rel=0.2)


# -------------------------------------------------------------------------------------------------- what is rejected


def refused(events, rig):
    answer = reconstruct(events, rig)
    assert not answer.converged
    assert answer.h is answer.h_sd is answer.touched is None
    assert answer.reason
    return answer.reason.code


def test_one_side_of_the_dead_centre_is_rejected(tilt):
    rig, events, _ = tilt
    first = [event for event in events if event.t_sample < 5.4]
    assert refused(first, rig) == Code.ONE_SIDE


def test_a_constant_height_is_rejected(tilt):
    rig, events, _ = tilt
    flat = arms(events, lambda arm: replace(arm, z=0.02, vz=0.0, az=0.0))
    assert refused(flat, rig) == Code.UNDETERMINED


@pytest.mark.nightly
def test_heights_that_contradict_the_readings_are_rejected(slide):
    """For a rigid gripper see `test_pivot_bad_input`."""
    rig, events, _ = slide
    higher = arms(events, lambda arm: replace(arm, z=arm.z + 0.008))
    assert refused(higher, rig) == Code.UNEXPLAINED  # a rolling body's radius is known


def test_a_log_without_forces_is_rejected(tilt):
    rig, events, _ = tilt
    assert refused(pads(events, lambda pad: replace(pad, force=None)), rig) == Code.NO_FORCE


@pytest.mark.nightly
def test_a_log_of_two_objects_is_rejected(tilt):
    rig, events, _ = tilt
    other = run_of("tilt", SEED + 1)[1]
    both = [each for each in events if each.t_sample < 6.0] + [each for each in other if each.t_sample >= 6.0]
    assert refused(both, rig)


def test_missing_data_is_named(tilt, slide):
    rig, events, _ = tilt
    assert refused([each for each in events if isinstance(each, PadSample)], rig) == Code.NO_ARM_REPORTS
    assert refused([each for each in events if isinstance(each, GripperSample)], rig) == Code.UNTOUCHED
    rig, events, _ = slide
    unmeasured = arms(events, lambda arm: replace(arm, z=None))
    assert refused(unmeasured, rig) == refused(events, replace(rig, z_measured=False)) == Code.NO_HEIGHT
    still = arms(events, lambda arm: replace(arm, x=0.02, vx=0.0, ax=0.0))
    assert refused(still, rig) == Code.UNDETERMINED


# ------------------------------------------------------------------------------------------------------- the parts


def test_a_path_follows_its_plan_and_shifts_at_the_arms_silence():
    t = np.arange(0.0, 6.0, 0.016)
    t = t[(t < 2.0) | (t > 3.0)]
    true = 0.02 + 0.01 * np.sin(t)
    rng = np.random.default_rng(0)
    path = axis_path(t, true + rng.normal(0, 2e-5, len(t)), list(0.01 * np.cos(t)), list(-0.01 * np.sin(t)), 2e-5)
    at = np.linspace(0.1, 1.9, 50)
    assert np.abs(path.at(at)[0] - 0.02 - 0.01 * np.sin(at)).max() < 8e-6
    at = np.linspace(3.1, 5.9, 50)
    assert np.abs(path.at(at)[0] - 0.02 - 0.01 * np.sin(at)).max() < 8e-6
    assert np.abs(path.at(at)[2] + 0.01 * np.sin(at)).max() < 1e-5


def test_a_contacts_spline_has_the_right_value_and_rates():
    touch = TouchSpan(1.0, 3.0, 5, 13)
    knots = 1.0 + touch.spacing * (np.arange(13) - 1)
    c = np.zeros(18)
    c[touch.coefficients] = 2.0 + 3.0 * knots  # splines reproduce straight lines exactly
    t = np.linspace(1.0, 3.0, 7)
    first, weights = touch.taps(t)
    psi, omega, alpha = np.einsum("nqk,nk->qn", weights, c[first[:, None] + np.arange(4)])
    assert psi == pytest.approx(2.0 + 3.0 * t)
    assert omega == pytest.approx(3.0)
    assert alpha == pytest.approx(0.0, abs=1e-9)


def test_a_side_is_fitted_from_its_readings_alone(tilt):
    rig, events, truth = tilt
    record = lay_out(events, arm_motion(events, rig), rig)
    side = side_of(record, record.touches[0])
    psi = np.interp(side.t, truth["t"], truth["psi_rad"])
    off = side.theta + psi
    assert np.abs(off - np.median(off)).max() < 0.05
    assert side.side == np.sign(truth["e_m"][10])
    cost, coefficients = outline_through(side.theta, side.h, side.e, prior_of(record))
    assert cost < 300.0
    assert 0.01 < coefficients[0] < 0.03


def test_the_best_start_has_the_right_rotation_of_the_sides(tilt):
    rig, events, truth = tilt
    record = lay_out(events, arm_motion(events, rig), rig)
    known = prior_of(record)
    start = rigid_starts(record, known, [side_of(record, touch) for touch in record.touches])[0]
    psi = record.motion(start.c, record.readings)[:, 0]
    off = (psi - np.interp(record.readings.t, truth["t"], truth["psi_rad"]) + math.pi) % math.tau - math.pi
    assert np.percentile(np.abs(off), 90) < 0.15


def test_rotating_a_bodys_parameters_is_reversible():
    p = np.zeros(P.SHAPE + 21)
    p[P.SHAPE], p[P.SHAPE + 1], p[P.MOMENT] = 0.02, 0.005, 1e-3  # h and centre of mass in one direction
    there = turned(p, 0.7)
    assert there[P.SHAPE + 1 : P.SHAPE + 3] * 0.2 == pytest.approx(there[P.MOMENT : P.MOMENT + 2])
    assert turned(there, -0.7) == pytest.approx(p)
