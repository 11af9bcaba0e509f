"""Information of motions about the rig's constants: a circle in closed form, and unobservable constants."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palmd.events import FloatArray, PlanningBelief
from palmd.model import shape_map
from palmd.model.rollout import OUTPUTS, THETA
from palmd.model.smoothing import ORDER, RIG_CONSTANTS, R
from palmd.motion.rig_information import READING_S, RigInformation, rig_cost
from palmd.motion.rollout_predictor import BINS, CALL_S
from palmd.system.description import RigDescription
from palmd.system.mechanism import normal_directions

RADIUS_M = 0.02
EVERYWHERE = np.ones(BINS, dtype=np.bool_)
OUTLINE = 2 * ORDER + 1


def circle(*steps: dict[int, float], radius_m: float = 0.0) -> PlanningBelief:
    """A circle known but for independent `steps` of the rig's constants; the first also changes its radius."""
    states = np.zeros((1, shape_map.N))
    states[0, shape_map.Z.SHAPE] = RADIUS_M
    spread = np.zeros((OUTLINE + RIG_CONSTANTS, RIG_CONSTANTS))
    spread[0, 0] = radius_m
    for column, step in enumerate(steps):
        for constant, value in step.items():
            spread[OUTLINE + constant, column] = value
    nothing = np.zeros(RIG_CONSTANTS)
    return PlanningBelief(0.0, states, EVERYWHERE, np.full(BINS, 1e-6), 1, nothing, spread)


def standing(opening: float, seconds: float) -> tuple[FloatArray, FloatArray]:
    """The path of a stand at this opening of the palms (rad), and the duration of its only move."""
    path = np.zeros((1, round(seconds / CALL_S), OUTPUTS))
    path[..., THETA] = normal_directions((0.7, opening), 0.0)
    return path, np.array([[seconds]])


@pytest.mark.parametrize("opening_deg", [50.0, 90.0, 130.0])
def test_the_information_about_the_opening_matches_the_closed_form_for_a_circle(opening_deg: float) -> None:
    """Both palms read s = r cot(φ2/2), and the belief about r changes proportionally to the error of φ2."""
    off, opening = 2e-3, math.radians(opening_deg)
    belief = circle({R.TURN: off}, radius_m=off * RADIUS_M)
    cost = rig_cost(belief, EVERYWHERE)
    assert cost is not None
    assert cost.sd == pytest.approx(off * RADIUS_M)
    rig = RigDescription()
    information = RigInformation(rig).of(belief, cost, *standing(opening, 0.4))
    moved = off * RADIUS_M * (1.0 / math.tan(opening / 2) - 0.5 / math.sin(opening / 2) ** 2)
    expected = 2 * 0.4 / READING_S * moved**2 / rig.pads[0].reading_variance
    assert np.trace(information[0, 0]) == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert cost.share_determined(information)[0, 0] == pytest.approx(expected / (1 + expected), rel=1e-6, abs=1e-9)
    again = 1 / (1 + expected) - 1 / (1 + 2 * expected)
    assert cost.share_determined(information, information[0, 0])[0, 0] == pytest.approx(again, rel=1e-6, abs=1e-9)


def test_unobservable_constants_have_no_cost() -> None:
    """Standoffs and a common scale are left out; a difference of scales is not."""
    step = 2e-4
    for never in ({R.STANDOFF: step}, {R.STANDOFF + 1: step}, {R.SCALE: 0.01, R.SCALE + 1: 0.01}):
        cost = rig_cost(circle(never, radius_m=step), EVERYWHERE)
        assert cost is not None
        assert cost.sd < 1e-9
        assert cost.band_sd == pytest.approx(math.hypot(step, 1e-6))
    cost = rig_cost(circle({R.SCALE: 0.01, R.SCALE + 1: -0.01}, radius_m=step), EVERYWHERE)
    assert cost is not None
    assert cost.sd == pytest.approx(step)


def test_errors_equivalent_to_a_rotation_give_no_information() -> None:
    """An error of φ1 turns all normals, as a rotation of the object does."""
    belief = circle({R.TILT: 2e-3}, radius_m=1e-5)
    belief.states[0, shape_map.Z.SHAPE + 3] = 1e-3
    belief.rig_spread[0, 0] = 0.0
    belief.rig_spread[5, 0] = 1e-9
    cost = rig_cost(belief, EVERYWHERE)
    assert cost is not None
    free = RigInformation(RigDescription()).of(belief, cost, *standing(1.2, 0.4))
    assert np.trace(free[0, 0]) < 1e-3  # 40 readings of each pad, which it moves by some tenths of a sigma


def test_information_of_moves_accumulates() -> None:
    belief = circle({R.TURN: 2e-3}, {R.ZERO: 1e-4})
    cost = rig_cost(belief, EVERYWHERE)
    assert cost is not None
    information = RigInformation(RigDescription())
    path, _ = standing(1.2, 0.8)
    split = information.of(belief, cost, path, np.array([[0.4, 0.4]]))
    assert np.allclose(split[0, 1], 2 * split[0, 0])
    path[:, 10:] = np.nan  # not used
    cut = information.of(belief, cost, path, np.array([[0.4, 0.4]]))
    assert np.allclose(cut[0, 0], cut[0, 1])


def test_without_knowledge_of_the_rig_there_is_no_cost() -> None:
    belief = circle()
    assert rig_cost(PlanningBelief(0.0, belief.states, EVERYWHERE, belief.h_sd, 1), EVERYWHERE) is None
