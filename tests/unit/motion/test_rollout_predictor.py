"""Predicted motions against the emulated rig's plant with the same body, surface and moves."""

import math
from functools import cache

import numpy as np
import pytest

from palmd.config.two_palms import LimitsConfig
from palmd.events import PalmMotion
from palmd.model import shape, shape_map
from palmd.model.outputs import rig_inputs
from palmd.model.smoothing import RIG_CONSTANTS, R
from palmd.motion.limits import PHI12_MAX, MotionLimits
from palmd.motion.rollout_predictor import (
    BINS,
    CALL_S,
    MOST_MOVES,
    Moves,
    Prediction,
    RolloutPredictor,
    goodness,
    may_hop,
    most_forces,
    tangents,
)
from palmd.motion.segments import Move
from palmd.rig.friction import plant_on
from palmd.rig.imperfections import PERFECT, Imperfections
from palmd.rig.plant import Hinge, random_surface, stable_poses
from palmd.rig.shaker import drawn_shaking
from palmd.rig.shapes import random_body
from palmd.system.arcs import joints_of
from palmd.system.description import PadSensor, RigDescription
from palmd.system.vibration import Vibration

START = tuple(np.radians((45.0, 90.0)).tolist())
ROUTE = np.radians([(52.0, 88.0), (40.0, 97.0), (58.0, 84.0)])
DURATIONS = (0.64, 0.8, 0.72)
FINE_S = 5e-4
FAST_HZ = 2500.0


@cache
def predictor(hinge, relation="independent"):
    return RolloutPredictor(rig_inputs(RigDescription(hinge=hinge, vibration=Vibration(relation, frequency=FAST_HZ))))


def simulated_body(kind, seed):
    """A body and a surface, a start orientation for the body, and the shape map's state of both."""
    random = np.random.default_rng([seed, 3])
    body, surface = random_body(kind, random), random_surface(kind, random)
    psi = stable_poses(body, PalmMotion.at_rest(START))[0]
    state = np.zeros(shape_map.N)
    state[shape_map.Z.PSI] = psi
    state[shape_map.Z.LN_RHO], state[shape_map.Z.MU] = math.log(body.rho), surface.mu
    state[shape_map.Z.LN_DITHER], state[shape_map.Z.DAMPING] = math.log(surface.dither), surface.damping
    theta = np.arange(360) * (math.tau / 360)
    state[shape_map.Z.SHAPE :] = shape.coefficients_of(body.support.sample(theta))
    return body, surface, psi, state


def emulated(body, surface, hinge, off=PERFECT, relation="independent"):
    """The rig's plant on palms that vibrate as in the model: too fast for the object to follow, on rigid mounts."""
    known = Vibration(relation, frequency=FAST_HZ, speed=2.0 / math.pi * surface.dither, speed_sd=0.0)
    shaking = drawn_shaking(known, np.random.default_rng(5), speed=0.0, pure=True)
    return plant_on(body, Hinge(hinge), surface, shaking=shaking, imperfections=off)


def driven(body, surface, psi, hinge, off=PERFECT, relation="independent"):
    """The plant's result on the route: ψ and ω0 after each move, bins touched, least force (m/s²), contacts (m)."""
    plant = emulated(body, surface, hinge, off, relation)
    plant.place(off.true_palms(PalmMotion.at_rest(START)), psi)
    here, ends, bins, force, contacts = START, [], set(), math.inf, []
    for end, duration in zip(ROUTE, DURATIONS, strict=True):
        end = tuple(end.tolist())
        move = Move(here, end, duration)
        for step in range(round(duration / FINE_S)):
            palms = off.true_palms(move.at((step + 1) * FINE_S))
            plant.advance(off.true_palms(move.at((step + 0.5) * FINE_S)), palms, FINE_S)
            one, two = plant.contacts()
            force = min(force, *(each / body.mass for each in plant.least_forces))
            contacts += [one.s, two.s]
            normals = (palms.angles[0] - math.pi / 2, palms.angles[0] + palms.angles[1] - 1.5 * math.pi)
            bins |= {math.floor((normal - plant.state.psi) / (math.tau / BINS)) % BINS for normal in normals}
        here = end
        ends.append((plant.state.psi, plant.mean_omega0))
    return np.array(ends), bins, force, min(contacts), max(contacts)


@pytest.mark.parametrize(
    ("kind", "seed", "hinge", "relation"),
    [
        *((*each, hinge, "independent") for each in (("friction", 1), ("friction", 4), ("rig", 2), ("nominal", 3))
          for hinge in ("fixed", "arc")),
        *(("friction", 4, "arc", relation) for relation in ("in_phase", "antiphase")),
    ],
)  # fmt: skip
def test_the_plant_moves_as_predicted(kind, seed, hinge, relation):
    body, surface, psi, state = simulated_body(kind, seed)
    ends, bins, force, low, high = driven(body, surface, psi, hinge, relation=relation)
    predicted = predictor(hinge, relation).of(state, Moves(START, ROUTE[None], np.array([DURATIONS])))
    np.testing.assert_allclose(predicted.psi[0], ends[:, 0], atol=3e-3)
    np.testing.assert_allclose(predicted.omega0[0], ends[:, 1], atol=0.05)
    assert predicted.least_force[0, -1] == pytest.approx(force, abs=0.25)
    assert predicted.nearest[0, -1] == pytest.approx(low, abs=1e-4)
    assert predicted.farthest[0, -1] == pytest.approx(high, abs=1e-4)
    mine = set(np.flatnonzero(predicted.touched[0, -1]).tolist())
    assert len(mine ^ bins) <= 2  # a bin at the edge of the touched range may differ


def test_touched_bins_and_extremes_accumulate_over_moves():
    """The first move is the most violent: its least force remains to the end."""
    _, _, _, state = simulated_body("friction", 1)
    predicted = predictor("arc").of(state, Moves(START, ROUTE[None], np.array([[0.24, 0.8, 1.2]])))
    assert (np.diff(predicted.touched[0].sum(axis=1)) >= 0).all()
    assert predicted.touched[0, 2].sum() > predicted.touched[0, 0].sum()
    assert (np.diff(predicted.least_force[0]) <= 0.0).all()
    assert (np.diff(predicted.farthest[0]) >= 0.0).all()


def test_a_prediction_from_the_middle_of_a_move_has_the_same_end():
    """The rest of the move, from the state half-way through."""
    _, _, _, state = simulated_body("friction", 4)
    arc_predictor = predictor("arc")
    whole = arc_predictor.of(state, Moves(START, ROUTE[None, :1], np.array([[0.8]])))
    begun = 5 * CALL_S
    short = Move(START, tuple(ROUTE[0].tolist()), 0.8)
    plant_like = arc_predictor.of(state, Moves(START, np.tile(ROUTE[:1], (1, 1, 1)), np.array([[0.8]])))
    np.testing.assert_array_equal(plant_like.psi, whole.psi)
    body, surface, psi, _ = simulated_body("friction", 4)
    plant = emulated(body, surface, "arc")
    plant.place(PalmMotion.at_rest(START), psi)
    for step in range(round(begun / FINE_S)):
        plant.advance(short.at((step + 0.5) * FINE_S), short.at((step + 1) * FINE_S), FINE_S)
    middle = state.copy()
    middle[:2] = plant.state.psi, plant.mean_omega0
    rest = arc_predictor.of(middle, Moves(START, ROUTE[None, :1], np.array([[0.8]])), begun)
    assert rest.psi[0, 0] == pytest.approx(whole.psi[0, 0], abs=2e-3)
    assert rest.touched[0, 0].sum() < whole.touched[0, 0].sum() + 1


def test_predictions_in_a_batch_equal_single_ones():
    """More than one batch, with durations of all lengths."""
    states = np.array([simulated_body("friction", seed)[3] for seed in (1, 4)])
    random = np.random.default_rng(2)
    count = 45
    which = random.integers(2, size=count)
    ends = START + random.uniform(-0.2, 0.2, (count, 2, 2))
    durations = CALL_S * random.integers(8, 40, (count, 2))
    together = predictor("arc").of(states[which], Moves(START, ends, durations))
    for i in (0, 31, 32, 44):
        alone = predictor("arc").of(states[which[i]], Moves(START, ends[i : i + 1], durations[i : i + 1]))
        for name in ("touched", "least_force", "nearest", "farthest", "psi", "omega0"):
            np.testing.assert_array_equal(getattr(together, name)[i], getattr(alone, name)[0], err_msg=name)


def test_a_diverging_prediction_is_unsafe_and_raises_no_warning():
    _, _, _, state = simulated_body("friction", 1)
    state[shape_map.Z.OMEGA0] = 1e25
    predicted = predictor("arc").of(state, Moves(START, ROUTE[None], np.array([DURATIONS])))
    assert not predicted.least_force[0, -1] > 0.0


def test_a_thrown_object_is_predicted_to_lose_a_contact():
    """The palm moves down faster than the object can fall."""
    _, _, _, state = simulated_body("friction", 1)
    hasty = Moves(START, np.radians([[[45.0, 150.0]]]), np.array([[0.12]]))
    assert predictor("arc").of(state, hasty).least_force[0, 0] < 0.0


def test_on_a_cradle_the_tangent_at_the_contact_is_limited_like_a_flat_palm():
    """The tangent from θ and ψ equals that from the contact's place and the curvature."""
    kappa = (13.3, 13.3)
    rig = RigDescription(pads=tuple(PadSensor(curvature=each) for each in kappa))
    limits = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555, curvatures=kappa)
    state = simulated_body("nominal", 4)[3]
    here = np.radians((40.0, 115.0))
    ends = np.radians([[(first, 110.0)] for first in (60.0, 68.0, 78.0, 84.0)])
    moves = Moves(here, ends, np.full((4, 1), 1.2))
    predicted = RolloutPredictor(rig_inputs(rig)).of(state, moves)
    last = predicted.path[:, -1]
    tangent = tangents(predicted.path)[1][:, -1]
    assert tangent == pytest.approx(ends.sum(axis=-1)[:, 0] - kappa[1] * last[:, 5], abs=2e-3)
    steepest = tangents(predicted.path)[1].max(axis=1)
    assert (goodness(predicted, moves, limits)[steepest > PHI12_MAX] < 0.0).all()
    assert steepest.min() < PHI12_MAX - math.radians(1.0) < PHI12_MAX < steepest.max()
    assert goodness(predicted, moves, limits)[0] > 1.0


def test_wedging_on_a_cradle_is_predicted_with_friction_only():
    """A circle between tangents 2α apart is pressed by g/(2(sin α − μ cos α)) when it slides out."""
    kappa = (13.3, 13.3)
    rig = RigDescription(pads=tuple(PadSensor(curvature=each) for each in kappa))
    limits = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555, curvatures=kappa)
    state = simulated_body("nominal", 4)[3].copy()
    state[shape_map.Z.SHAPE :], state[shape_map.Z.DAMPING] = 0.0, 0.0
    state[shape_map.Z.SHAPE] = radius = 0.02
    here, opened = (joints_of(radius, (math.radians(90.0 - half), math.radians(2 * half)), kappa) for half in (30, 35))
    safe = []
    for mu in (0.0, 0.3):
        state[shape_map.Z.MU] = mu
        closed = joints_of(radius, (math.radians(79.0), math.radians(22.0)), kappa)
        moves = Moves(np.array(here), np.array([[opened, closed]]), np.full((1, 2), 2.0))
        safe.append(goodness(RolloutPredictor(rig_inputs(rig)).of(state, moves), moves, limits)[0])
    assert (safe[0] > 1.0).all(), "no wedging without friction"
    assert safe[1][0] > 1.0, "a later state does not count yet"
    assert safe[1][1] < 0.0, "α of 11° is less than the friction angle of 17°"


def test_predictions_include_the_estimated_rig_constants():
    body, surface, psi, state = simulated_body("friction", 4)
    tilt, turn, asymmetry = math.radians(1.5), math.radians(-1.0), 0.6
    off = Imperfections(angles=(tilt, turn), friction=asymmetry)
    ends, *_ = driven(body, surface, psi, "arc", off, relation="in_phase")
    described = RigDescription(vibration=Vibration(frequency=FAST_HZ))
    mine, moves = RolloutPredictor(rig_inputs(described)), Moves(START, ROUTE[None], np.array([DURATIONS]))
    assert np.abs(mine.of(state, moves).psi[0] - ends[:, 0]).max() > 0.02
    off = np.zeros(RIG_CONSTANTS)
    off[[R.TILT, R.TURN, R.FRICTION, R.KAPPA]] = tilt, turn, asymmetry, -1.0
    mine.correct(off)
    np.testing.assert_allclose(mine.of(state, moves).psi[0], ends[:, 0], atol=3e-3)


def test_more_moves_than_the_limit_are_refused():
    moves = Moves(START, np.zeros((1, MOST_MOVES + 1, 2)), np.ones((1, MOST_MOVES + 1)))
    with pytest.raises(ValueError, match="1 to 16 moves, got 17"):
        predictor("arc").of(np.zeros(shape_map.N), moves)


def pressed(least, mean):
    """A prediction of one sequence of two moves of two calls each, with these contact forces (m/s²) after each call."""
    path = np.zeros((1, 4, 10))
    path[0, :, 2:4], path[0, :, 6:8] = np.array(least)[:, None], np.array(mean)[:, None]
    fine = {"least_force": np.full((1, 2), 9.0), "nearest": np.full((1, 2), 0.02), "farthest": np.full((1, 2), 0.03)}
    nothing = {"touched": np.zeros((1, 2, BINS), dtype=np.bool_), "psi": np.zeros((1, 2)), "omega0": np.zeros((1, 2))}
    return Prediction(**fine, **nothing, path=path)


TWO_MOVES = Moves(np.array(START), np.tile(np.array(START), (1, 2, 1)), np.full((1, 2), 2 * CALL_S))


def test_a_contact_may_hop_once_its_least_force_falls_below_half_the_mean_by_a_margin():
    assert may_hop(pressed([5.0, 5.0, 5.0, 5.0], [6.0] * 4), TWO_MOVES).tolist() == [[False, False]]
    assert may_hop(pressed([5.0, 5.0, 3.2, 5.0], [6.0] * 4), TWO_MOVES).tolist() == [[False, True]]
    assert may_hop(pressed([3.2, 5.0, 5.0, 5.0], [6.0] * 4), TWO_MOVES).tolist() == [[True, True]]


def test_a_force_at_the_limit_is_unsafe_and_three_sigmas_below_is_safe():
    pads = (PadSensor(), PadSensor())
    limits = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555, pad_forces=(5.0, 5.0))
    most = most_forces(limits, pads, 0.2, 0.0)
    sd = math.sqrt(pads[0].force_variance(5.0))
    assert most.limit == pytest.approx([25.0, 25.0])
    assert most.allowed == pytest.approx([(5.0 - 3.0 * sd) / 0.2] * 2)
    assert most_forces(limits, pads, 0.2, 0.01).allowed[0] < most.allowed[0], (
        "an uncertain mass lowers the allowed force"
    )

    def how_safe(second):
        mean = [6.0, 6.0, second, 6.0]
        return goodness(pressed(mean, mean), TWO_MOVES, limits, most=most)[0]

    assert how_safe(most.allowed[0] - 1e-6)[1] > 1.0
    assert how_safe(0.5 * (most.allowed[0] + most.limit[0])) == pytest.approx([how_safe(6.0)[0], 0.5])
    assert how_safe(most.limit[0] + 1e-6)[1] < 0.0
