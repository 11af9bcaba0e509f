"""Candidate motions of the explorer: always within the limits, and whole calls long."""

import math

import numpy as np
import pytest

from palmd.config.two_palms import Config
from palmd.model import rollout
from palmd.motion import candidates
from palmd.motion.check import motion_limits
from palmd.motion.kinematics import RigGeometry
from palmd.motion.limits import MotionLimits, Workspace, problems, ranges
from palmd.motion.segments import Move
from palmd.rig.adept_arm import arm_limits
from palmd.rig.world import default_config

DRAWS = 500
KINDS = (candidates.loops, candidates.single_moves)
LENGTH = 5


def limits_of(config: Config, strength: float = 1.0) -> MotionLimits:
    """Limits with the workspace that the emulated controller reports, and an arm scaled by `strength`."""
    allowed = arm_limits(config)
    workspace = Workspace(
        RigGeometry.from_config(config), allowed.x_min, allowed.x_max, allowed.y_min, allowed.y_max,
        strength * allowed.v_max, strength * allowed.a_max,
    )  # fmt: skip
    plain = motion_limits(config)
    return MotionLimits(plain.angles, plain.rate, plain.acceleration, plain.pad_length, workspace)


NARROW = default_config().model_copy(
    update={"limits": default_config().limits.model_copy(update={"phi1_deg": (30.0, 70.0), "rate_deg_s": 40.0})}
)
STARTS = [(45.0, 90.0), (31.0, 75.0), (69.0, 100.0)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "limits",
    [limits_of(default_config()), limits_of(NARROW), limits_of(default_config(), 0.2)],
    ids=["shipped", "narrow", "weak arm"],
)
def test_candidates_keep_all_limits(kind, limits):
    """Angles, their sum, rates, accelerations and the arm, along more than a thousand moves."""
    random = np.random.default_rng(5)
    for start_deg in STARTS:
        start = np.radians(start_deg)
        moves = kind(random, start, DRAWS // 5, LENGTH, limits)
        for ends, durations in zip(moves.ends.tolist(), moves.durations.tolist(), strict=True):
            here = tuple(start.tolist())
            for end, duration in zip(map(tuple, ends), durations, strict=True):
                move = Move(here, end, duration)
                motion = [limits.values(move.at(t)) for t in np.linspace(0.0, move.duration, 15).tolist()]
                assert problems(limits.bounds, ranges(motion)) == [], (np.degrees(here), np.degrees(end), duration)
                here = end


@pytest.mark.parametrize(("width_deg", "middle_deg"), [(0.0, 45.0), (0.5, 45.25), (3.0, 46.5), (3.5, 46.75)])
def test_a_range_narrower_than_its_margins_shrinks_to_its_middle(width_deg, middle_deg):
    angles = np.radians(((45.0, 45.0 + width_deg), (60.0, 120.0)))
    limits = MotionLimits(tuple(map(tuple, angles.tolist())), 1.0, 9.0, 0.05)
    low, high = candidates.range_of(limits)
    assert (low <= high).all()
    assert (low + high) / 2 == pytest.approx(np.radians((middle_deg, 90.0)))
    assert high[0] - low[0] == pytest.approx(math.radians(max(width_deg - 3.0, 0.0)))


@pytest.mark.parametrize("kind", KINDS)
def test_durations_are_whole_calls_and_draws_depend_on_the_generator_only(kind):
    limits = motion_limits(default_config())
    start = np.radians((45.0, 90.0))
    one, other, same = (kind(np.random.default_rng(seed), start, 300, LENGTH, limits) for seed in (1, 2, 1))
    calls = one.durations / (rollout.SUBSTEPS * rollout.STEP_S)
    np.testing.assert_allclose(calls, np.round(calls), atol=1e-9)
    assert calls.min() >= 3
    assert one.ends.shape == (300, LENGTH, 2)
    np.testing.assert_array_equal(one.ends, same.ends)
    assert not np.array_equal(one.ends, other.ends)


def test_loops_go_in_both_directions_and_return():
    """Corners 3 and 5 are the opposite of corner 1 and corner 1 itself, unless a limit intervenes."""
    limits = motion_limits(default_config())
    ends = candidates.loops(np.random.default_rng(1), np.radians((45.0, 90.0)), DRAWS, LENGTH, limits).ends
    np.testing.assert_allclose(ends[:, 4], ends[:, 0], atol=1e-12)
    corners = np.stack([ends[..., 0], ends.sum(axis=-1)], axis=-1)
    side, next_side = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1]
    area = side[:, 0] * next_side[:, 1] - side[:, 1] * next_side[:, 0]
    assert 0.3 < np.mean(area > 0.0) < 0.7


def test_a_lower_rate_takes_longer_and_the_acceleration_is_kept():
    limits = motion_limits(default_config())
    start, ends = np.radians((45.0, 90.0)), np.radians([[[75.0, 90.0]]])
    slow, fast, hasty = (
        candidates.timed(start, ends, np.array([[math.radians(rate)]]), limits) for rate in (20.0, 80.0, 1e6)
    )
    assert slow.durations[0, 0] == pytest.approx(15 / 8 * 30.0 / 20.0, abs=0.04)
    assert fast.durations[0, 0] == pytest.approx(15 / 8 * 30.0 / 80.0, abs=0.04)
    peak = Move(tuple(start), tuple(ends[0, 0]), float(hasty.durations[0, 0]))
    most = max(abs(peak.at(t).accelerations[0]) for t in np.linspace(0.0, peak.duration, 200))
    assert 0.5 * limits.acceleration < most <= limits.acceleration
