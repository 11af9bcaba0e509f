"""Predicting the motion of a body between three palms, and choosing moves that show the rest of it."""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from body_stand import WIDE, BodyStand, known_parameters
from plain_body_equations import acceleration_kernel

from palmd.model import rotation
from palmd.model.body_rollout import ROUGH_ORDER
from palmd.model.icosphere import icosphere
from palmd.model.spherical import count
from palmd.model.three_palms import BODY
from palmd.motion import body_explorer
from palmd.motion.body_explorer import DECISION_S, DRAWN_BODIES, LEAST_SHARE, BodyDraws, BodyExplorer, weight_shares
from palmd.motion.body_prediction import COLUMNS, Bearings, BodyPredictor
from palmd.motion.segments import Move
from palmd.motion.three_palms import TiltLimits
from palmd.observer.three_palms.body import ORDER
from palmd.observer.three_palms.kernels import by_columns, palm_inputs
from palmd.rig.three_palms.world import REST_POSE
from palmd.system.three_palms import ThreePalmsRig, palms_at
from tools.studies.space_logs import STEP_S

GRAVITY, SIDE, SEED = 9.81, 0.075, 4
RIG = ThreePalmsRig()
SPIN = (2.0, -1.5, 1.0)
LIMITS = TiltLimits.over(WIDE, 1e3 * SIDE)


@cache
def stand():
    """A body at rest, and the parameters that are known of it."""
    there = BodyStand(SEED, GRAVITY)
    return there, known_parameters(there.plant.body, there.plant.friction)


def bearings(count, omega=(0.0, 0.0, 0.0)):
    R = stand()[0].bearings[0]
    return Bearings(np.repeat(R, count, axis=0), np.tile(omega, (count, 1)), np.tile(REST_POSE, (count, 1)))


def integrated(move, R, omega, p, h=5e-4):
    """Rotation, spin and contact normals of a move by the observer's kernel and Heun's method in small steps."""
    acceleration, normals = acceleration_kernel(ORDER), []

    def rates(t, R, omega):
        at = move.at(t)
        each = (np.array([getattr(at, name)]) for name in ("angles", "rates", "accelerations"))
        planes = palms_at(*each)
        out = acceleration((by_columns(R[None]), omega[None], palm_inputs(planes)), (p, RIG.kernel_constants))
        return out[0][0], -planes.normal[0] @ R

    for k in range(round(move.duration / h)):
        first, touched = rates(k * h, R, omega)
        ahead = rotation.exp(h * (omega + 0.5 * h * first)) @ R
        second, _ = rates((k + 1) * h, ahead, omega + h * first)
        R = rotation.exp(h * (omega + 0.25 * h * (first + second))) @ R
        omega = omega + 0.5 * h * (first + second)
        normals.append(touched)
    return R, omega, np.array(normals)


def test_a_prediction_agrees_with_integrating_the_observers_equations():
    p = stand()[1]
    ends = np.array([[1.05, 0.7, 0.9], [0.8, 0.9, 0.75], *np.tile(REST_POSE, (COLUMNS - 2, 1))])
    durations = np.array([0.3, 0.24, *np.full(COLUMNS - 2, 0.2)])
    predicted = BodyPredictor(p, RIG).predict(bearings(COLUMNS, SPIN), ends, durations)
    for k in range(2):
        move = Move(tuple(REST_POSE.tolist()), tuple(ends[k].tolist()), float(durations[k]))
        R, omega, normals = integrated(move, stand()[0].bearings[0][0], np.array(SPIN), p)
        np.testing.assert_allclose(predicted.after.R[k], R, atol=5e-4)
        np.testing.assert_allclose(predicted.after.omega[k], omega, atol=3e-3)
        normals_predicted = predicted.normals[k][np.isfinite(predicted.normals[k][:, 0, 0])]
        assert len(normals_predicted) == math.ceil(durations[k] / 0.02)
        np.testing.assert_allclose(normals_predicted, normals[5::40], atol=6e-4)
        assert np.array_equal(predicted.after.joints[k], ends[k])


def test_a_moves_prediction_does_not_depend_on_the_others_in_its_batch():
    predictor, random = BodyPredictor(stand()[1], RIG), np.random.default_rng(0)
    ends = REST_POSE + random.uniform(-0.1, 0.1, (COLUMNS, 3))
    durations = random.uniform(0.05, 0.6, COLUMNS)
    p = stand()[1] * random.uniform(0.98, 1.02, (COLUMNS, 1))
    together = predictor.predict(bearings(COLUMNS, SPIN), ends, durations, 0.01, 0.02, p)
    for k in (int(durations.argmin()), int(durations.argmax()), 5):
        alone = predictor.predict(bearings(1, SPIN), ends[k : k + 1], durations[k : k + 1], 0.01, 0.02, p[k])
        for name in ("least_force", "room", "spin"):
            assert getattr(together, name)[k] == getattr(alone, name)[0]
        np.testing.assert_array_equal(together.after.some(np.array([k])).R, alone.after.R)
        np.testing.assert_array_equal(together.after.omega[k], alone.after.omega[0])
        normals_together = together.normals[k]
        np.testing.assert_array_equal(normals_together[np.isfinite(normals_together[:, 0, 0])], alone.normals[0])


def test_a_body_at_rest_stays_and_its_palms_carry_its_weight():
    predicted = BodyPredictor(stand()[1], RIG).predict(bearings(3), np.tile(REST_POSE, (3, 1)), np.full(3, 0.4))
    share = GRAVITY * weight_shares(REST_POSE[None])[0]
    assert predicted.least_force == pytest.approx(np.full(3, share.min()), rel=0.05)
    assert (predicted.spin < 0.3).all()  # truncated harmonics let it settle a little


def test_weight_shares_satisfy_static_equilibrium():
    still, pose = np.zeros((1, 3)), np.array([[0.7, 0.5, 1.1]])
    normal = palms_at(pose, still, still).normal[0]
    np.testing.assert_allclose(weight_shares(pose)[0] @ normal, [0.0, 0.0, 1.0], atol=1e-12)


def explorer(limits=LIMITS, seed=0):
    return BodyExplorer(BodyPredictor(stand()[1], RIG), limits, icosphere(2)[0], seed)


def test_moves_keep_the_limits_and_end_where_all_palms_carry_weight():
    planner, touched = explorer(), np.zeros(len(icosphere(2)[0]), np.bool_)
    move = planner.decide(bearings(1), touched)
    assert move is not None
    assert move.start == tuple(REST_POSE.tolist())
    for t in np.linspace(0.0, move.duration, 50):
        values = LIMITS.values(move.at(t))
        assert all(bound.problem(value, value) is None for bound, value in zip(LIMITS.bounds, values, strict=True))
    ends = planner._random_ends(np.tile(REST_POSE, (COLUMNS, 1)))
    assert weight_shares(ends).min() > 0.8 * LEAST_SHARE


def rooted(planner, touched):
    begin = bearings(1)
    planner._visited.append(begin.R[0])
    return body_explorer._MoveSequence(begin, touched, 0.0, (), 0.0, -math.inf)


def test_touched_directions_give_no_further_gain():
    planner, none = explorer(), np.zeros(len(icosphere(2)[0]), np.bool_)
    root = rooted(planner, none)
    fresh = [each for _ in range(body_explorer.ROUNDS) for each in planner._extended_randomly([root] * COLUMNS, root)]
    assert max(each.gain for each in fresh) > 2 * body_explorer.NOVELTY
    assert all(each.gain == each.touched.mean() for each in fresh)
    full = dataclasses.replace(root, touched=~none)
    again = planner._extended_randomly([full] * COLUMNS, full)
    assert max(each.gain for each in again) == 0.0
    assert max(each.value * (each.seconds + DECISION_S) for each in again) <= body_explorer.NOVELTY  # of new places


def test_the_rest_of_the_best_sequences_is_continued():
    planner, none = explorer(), np.zeros(len(icosphere(2)[0]), np.bool_)
    move = planner.decide(bearings(1), none)
    assert planner._plans
    there = planner._coarse.predict(
        bearings(1), np.array([move.end]), np.array([move.duration])
    ).after  # as in the tree
    root = body_explorer._MoveSequence(there, none, 0.0, (), 0.0, 0.0)
    again = planner._continued(root)
    assert {plan for plan in planner._plans if plan} <= {each.moves for each in again}
    ends = {each.moves[-1].end: each for each in again}
    for each in again:  # each continues from where its own beginning leads
        parent = root if len(each.moves) == 1 else ends[each.moves[-2].end]
        assert each.seconds == pytest.approx(parent.seconds + each.moves[-1].duration)
        after = planner._coarse.predict(
            parent.bearings, np.array([each.moves[-1].end]), np.array([each.moves[-1].duration])
        )
        np.testing.assert_allclose(after.after.R, each.bearings.R, atol=1e-12)
    elsewhere = dataclasses.replace(root, bearings=bearings(1))
    assert planner._continued(elsewhere) == []


def test_parents_are_the_best_the_farthest_turned_and_those_facing_untouched_surface():
    planner, directions = explorer(), icosphere(2)[0]
    root = rooted(planner, np.zeros(len(directions), np.bool_))
    grown = planner._extended_randomly([root] * COLUMNS, root)
    sought = planner._predictor.predict(bearings(1), np.array([grown[0].moves[0].end]), np.array([0.6])).normals[
        0, 0, 1
    ]
    parents = planner._parents([root, *grown], sought[None])
    half, quarter = COLUMNS // 2, COLUMNS // 4
    ranked = sorted([root, *grown], key=lambda each: -each.gain_rate)[: body_explorer.BEST_SEQUENCES]
    assert set(map(id, parents[:half])) == set(map(id, ranked))
    far = [body_explorer._chords(each.bearings.R, root.bearings.R)[0] for each in parents[half : half + quarter]]
    all_of_them = [body_explorer._chords(each.bearings.R, root.bearings.R)[0] for each in grown]
    assert np.mean(far) > 1.2 * np.mean(all_of_them)

    def faces(each):
        still = np.zeros((1, 3))
        return (-palms_at(each.bearings.joints, still, still).normal[0] @ each.bearings.R[0] @ sought).max()

    assert {faces(each) for each in parents[half + quarter :]} == {max(map(faces, [root, *grown]))}
    old = [dataclasses.replace(each, seconds=body_explorer.HORIZON_S) for each in grown]
    assert set(map(id, planner._parents([root, *old], sought[None]))) == {id(root)}


def test_there_is_no_move_if_every_move_might_lose_the_body():
    assert explorer().decide(bearings(1), np.zeros(len(icosphere(2)[0]), np.bool_), least_force=20.0) is None


def test_a_move_that_would_throw_the_body_is_replaced_by_the_next(monkeypatch):
    rest = tuple(REST_POSE.tolist())
    thrown, gentle = Move(rest, (1.2, 0.5, 1.0), 0.06), Move(rest, (0.95, 0.78, 0.8), 0.5)
    planner, known = explorer(), body_explorer._exact_draws(stand()[1])
    assert planner._safest(bearings(1), [(thrown,), (gentle,)], known) == (gentle,)
    assert planner._safest(bearings(1), [(thrown,)], known) == ()
    monkeypatch.setattr(body_explorer, "ERROR_RAD_S", 60.0)  # it may be spinning fast
    assert planner._safest(bearings(1), [(gentle,)], known) == ()


def test_a_sequence_with_a_safe_continuation_is_preferred():
    rest, gentle = tuple(REST_POSE.tolist()), (0.95, 0.78, 0.8)
    first, other = Move(rest, gentle, 0.5), Move(rest, (0.88, 0.82, 0.8), 0.5)
    thrown, back = Move(gentle, (1.2, 0.5, 1.0), 0.06), Move(gentle, rest, 0.5)
    planner, known = explorer(), body_explorer._exact_draws(stand()[1])
    assert planner._safe_moves(bearings(1), [(first, thrown), (first, back), (first,), (thrown, back)], known) == [
        1,
        2,
        1,
        0,
    ]
    assert planner._safest(bearings(1), [(first, thrown), (first, back)], known) == (first, back)
    assert planner._safest(bearings(1), [(first, thrown), (other,)], known) == (other,)
    assert planner._safest(bearings(1), [(first, thrown)], known) == (first,)


def test_a_move_of_the_known_body_is_safe_only_above_the_required_least_force():
    gentle = Move(tuple(REST_POSE.tolist()), (0.95, 0.78, 0.8), 0.5)
    planner, known = explorer(), body_explorer._exact_draws(stand()[1])
    end, duration = np.array([gentle.end]), np.array([gentle.duration])
    force = planner._predictor.predict(bearings(1), end, duration, rest=body_explorer.REST_S).least_force[0]
    planner._least_force = 0.98 * force
    assert planner._safe_moves(bearings(1), [(gentle,)], known) == [1]
    planner._least_force = 1.02 * force
    assert planner._safe_moves(bearings(1), [(gentle,)], known) == [0]


def test_the_coarse_predictor_is_near_the_exact_one_and_takes_new_parameters():
    planner, p = explorer(), stand()[1].copy()
    ends, durations = np.array([[1.05, 0.7, 0.9], [0.8, 0.9, 0.75]]), np.array([0.3, 0.24])
    rough, exact = (each.predict(bearings(2, SPIN), ends, durations) for each in (planner._coarse, planner._predictor))
    turned = body_explorer._chords(exact.after.R, bearings(2).R)
    assert (body_explorer._chords(rough.after.R, exact.after.R) < 0.2 * turned).all()
    assert np.isfinite(rough.normals[0, :, 0, 0]).sum() == np.isfinite(exact.normals[0, :, 0, 0]).sum()
    p[1:] *= 0.5
    planner._predictor.set_parameters(p)
    planner.decide(bearings(1), np.zeros(len(icosphere(2)[0]), np.bool_))
    np.testing.assert_array_equal(planner._coarse.parameters, np.concatenate([p[: count(ROUGH_ORDER)], p[-BODY:]]))


def test_a_safe_move_holds_every_drawn_body():
    planner, p = explorer(), stand()[1]
    gentle = Move(tuple(REST_POSE.tolist()), (0.95, 0.78, 0.8), 0.5)
    variance = np.full(6 + len(p), 1e-14)
    little = BodyDraws.of(p, np.diag(variance), np.random.default_rng(0))
    assert planner._safe_moves(bearings(1), [(gentle,)], little) == [1]
    last = np.arange(DRAWN_BODIES) == DRAWN_BODIES - 1  # one of them is enough
    wild = dataclasses.replace(little, spin=np.where(last[:, None], (60.0, 40.0, 0.0), 0.0))
    assert planner._safe_moves(bearings(1), [(gentle,)], wild) == [0]
    large = dataclasses.replace(little, p=little.p * np.where(last, 4.0, 1.0)[:, None])
    assert planner._safe_moves(bearings(1), [(gentle,)], large) == [0]  # it would reach beyond the pads
    there, here = (
        each._predictor.predict(bearings(1), REST_POSE[None], np.array([0.1])) for each in (planner, explorer())
    )
    np.testing.assert_array_equal(there.after.R, here.after.R)  # drawn bodies do not change the known one


def test_one_drawn_body_at_most_may_spin_fast(monkeypatch):
    monkeypatch.setattr(body_explorer, "ERROR_RAD_S", 0.0)
    planner, p = explorer(), stand()[1]
    gentle = Move(tuple(REST_POSE.tolist()), (0.95, 0.78, 0.8), 0.5)
    known = BodyDraws.of(p, np.diag(np.full(6 + len(p), 1e-14)), np.random.default_rng(0))
    planner._most_rad_s = 0.5  # and any drawn body up to 1.9 rad/s
    held = []
    for spinning in range(3):
        fast = np.arange(DRAWN_BODIES) >= DRAWN_BODIES - spinning
        draws = dataclasses.replace(known, spin=np.where(fast[:, None], (2.5, 0.0, 0.0), 0.0))
        held += planner._safe_moves(bearings(1), [(gentle,)], draws)
    assert held == [1, 1, 0]


def test_drawn_bodies_have_the_beliefs_covariance(monkeypatch):
    monkeypatch.setattr(body_explorer, "DRAWN_BODIES", 4000)
    p = np.zeros(count(1) + BODY)
    p[0] = 1e3  # a sphere, so that no draw is non-convex
    root = np.random.default_rng(1).normal(size=(6 + len(p), 6 + len(p)))
    drawn = BodyDraws.of(p, root @ root.T, np.random.default_rng(2))
    each = np.concatenate([drawn.turn, drawn.spin, drawn.p - p], axis=1)
    assert not each[0].any()  # the mean itself
    spread = np.sqrt(np.diagonal(root @ root.T))
    np.testing.assert_allclose((np.cov(each.T) - root @ root.T) / np.outer(spread, spread), 0.0, atol=0.1)


def test_a_decided_move_keeps_the_spin_limit(monkeypatch):
    planner, begin, none = explorer(), bearings(1), np.zeros(len(icosphere(2)[0]), np.bool_)
    root = rooted(planner, none)

    def fastest(most, peak):
        planner._most_rad_s = most
        monkeypatch.setattr(body_explorer, "PEAK_SPIN", peak)
        found = planner._extended_randomly([root] * COLUMNS, root)
        return max(body_explorer._chords(each.bearings.R, begin.R)[0] / (each.seconds + DECISION_S) for each in found)

    assert fastest(math.inf, 1.0) > 0.6
    assert fastest(0.3, 1e3) < 0.3
    monkeypatch.setattr(body_explorer, "PEAK_SPIN", 2.0)
    move = planner.decide(begin, none, most_rad_s=0.3)
    assert planner._predictor.predict(begin, np.array([move.end]), np.array([move.duration])).spin[0] < 0.6


def test_a_move_under_way_is_predicted_to_its_end_and_the_rest_after_it():
    predictor, rest = BodyPredictor(stand()[1], RIG), REST_POSE[None]
    end, duration = np.array([[1.05, 0.7, 0.9]]), np.array([0.3])
    first = predictor.predict(bearings(1, SPIN), end, duration)
    standing = predictor.predict(first.after, end, np.array([0.1]))
    whole = predictor.predict(bearings(1, SPIN), end, duration, rest=0.1)
    np.testing.assert_allclose(whole.after.R, standing.after.R, atol=1e-12)
    assert whole.least_force[0] == min(first.least_force[0], standing.least_force[0])
    # a quicker move follows another path
    halfway = predictor.predict(bearings(1, SPIN), end, np.array([0.15]), elapsed=0.0)
    late = predictor.predict(Bearings(halfway.after.R, halfway.after.omega, rest), end, duration, elapsed=0.3, rest=0.1)
    np.testing.assert_allclose(late.after.R, predictor.predict(halfway.after, end, np.array([0.1])).after.R, atol=1e-12)


def test_a_few_seconds_of_exploring_touch_new_surface():
    there = BodyStand(SEED, GRAVITY)
    directions = icosphere(3)[0]
    predictor = BodyPredictor(known_parameters(there.plant.body, there.plant.friction), ThreePalmsRig())
    explorer = BodyExplorer(predictor, LIMITS, directions, SEED)
    pose, t, touched = tuple(REST_POSE.tolist()), 0.0, np.zeros(len(directions), np.bool_)
    while t < 4.0:
        move = explorer.decide(Bearings(*there.bearings, np.array([pose])), touched) or Move(pose, pose, 0.5)
        move = Move(move.start, move.end, STEP_S * math.ceil(move.duration / STEP_S))
        normals, held = there.moved(move, SIDE)
        assert held
        t, pose = t + move.duration, move.end
        touched |= explorer.covered(normals)
    assert touched.mean() > 0.2
