"""Candidate palm motions for the explorer: loops that turn the object, and single moves, within the limits. Pure.

Friction holds the object to the palm that presses harder. On a loop in (φ1, φ12) one palm carries it on the way out
and the other on the way back, so that each round turns it further, like a ratchet. Without friction it follows the
stable poses, and single moves are enough.
"""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.motion.limits import MotionLimits
from palmd.motion.rollout_predictor import CALL_S, Moves
from palmd.motion.segments import PEAK_ACCELERATION, PEAK_RATE

POSE_MARGIN = math.radians(1.5)
RATE_SHARE = 0.9  # largest share of the limits that moves use
SLOWEST = math.radians(20.0)  # rad/s
SHORTEST_S = 3 * CALL_S
LOOP_HALF_1, LOOP_HALF_12 = (0.1, 0.95), (0.1, 0.85)  # rad, ranges of the loops' half axes in φ1 and φ12
NEARBY = 0.35  # rad, standard deviation of a loop's centre about the present pose, for half of the loops
SHIFTED, SHIFT = 0.5, 0.3  # share of a kept sequence's ends that is shifted; largest standard deviation of it (rad)
STEP_SHARE = (0.15, 1.0)  # range of a single move's length, as a share of the way to a random pose


def loops(random: np.random.Generator, start: FloatArray, count: int, length: int, limits: MotionLimits) -> Moves:
    """Draw `count` sequences of `length` moves on loops of random centre, direction, size and rate."""
    low, high = range_of(limits)
    middle1 = random.uniform(low[0], high[0], count)
    top = limits.top - POSE_MARGIN
    middle12 = random.uniform(min(low[0] + low[1], top), top, count)
    near = random.random(count) < 0.5
    middle1 = np.where(near, start[0] + random.normal(0.0, NEARBY, count), middle1)
    middle12 = np.where(near, start.sum() + random.normal(0.0, NEARBY, count), middle12)
    half1, half12 = random.uniform(*LOOP_HALF_1, count), random.uniform(*LOOP_HALF_12, count)
    angle = random.uniform(0.0, 2 * np.pi, count)[:, None] + random.choice([-1.0, 1.0], count)[:, None] * (
        np.arange(length) * (np.pi / 2)
    )
    first = middle1[:, None] + half1[:, None] * np.cos(angle)
    phi12 = middle12[:, None] + half12[:, None] * np.sin(angle)
    ends = _inside(np.stack([first, phi12 - first], axis=-1), limits)
    return timed(start, ends, _rates(random, count, limits)[:, None], limits)


def single_moves(
    random: np.random.Generator, start: FloatArray, count: int, length: int, limits: MotionLimits
) -> Moves:
    """Draw `count` sequences of `length` moves towards random poses; some move one palm angle only."""
    low, high = range_of(limits)
    ends = np.empty((count, length, 2))
    here = np.tile(start, (count, 1))
    for number in range(length):
        goal = random.uniform(low, high, (count, 2))
        stays = random.random((count, 1)) < np.array([[0.25, 0.5]])
        stays[:, 1] &= ~stays[:, 0]
        goal = np.where(stays, here, goal)
        here = _inside(here + (goal - here) * random.uniform(*STEP_SHARE, (count, 1)), limits)
        ends[:, number] = here
    return timed(start, ends, _rates(random, count, limits)[:, None], limits)


def visits(
    random: np.random.Generator, start: FloatArray, poses: FloatArray, length: int, limits: MotionLimits
) -> Moves:
    """Return for each of `poses` (P, 2) a sequence of `length` moves that goes there with the first and stays."""
    ends = np.repeat(poses[:, None], length, axis=1)
    return timed(start, ends, _rates(random, len(poses), limits)[:, None], limits)


def mutated(random: np.random.Generator, kept: Moves, count: int, limits: MotionLimits) -> Moves:
    """Draw `count` variations of the sequence `kept`: some of its moves' ends are shifted."""
    ends = np.repeat(kept.ends, count, axis=0)
    shifted = random.random((count, ends.shape[1], 1)) < SHIFTED
    ends = ends + shifted * random.normal(0.0, SHIFT, ends.shape) * np.exp(random.uniform(-2.0, 0.0, (count, 1, 1)))
    return timed(kept.start, _inside(ends, limits), _rates(random, count, limits)[:, None], limits)


def lengthened(kept: Moves) -> Moves:
    """Append a stay at the end of the rest of a sequence, to replace the first move, which has been executed."""
    stay = np.full((len(kept.durations), 1), SHORTEST_S)
    ends = np.concatenate([kept.ends, kept.ends[:, -1:]], axis=1)
    return Moves(kept.start, ends, np.concatenate([kept.durations, stay], axis=1))


def ending_at(moves: Moves, ends: FloatArray, limits: MotionLimits) -> Moves:
    """Replace the end of each sequence's last move by `ends` (N, 2)."""
    before = moves.ends[:, -2]
    last = timed(before, ends[:, None], np.full((len(ends), 1), RATE_SHARE * limits.rate), limits)
    return Moves(
        moves.start,
        np.concatenate([moves.ends[:, :-1], ends[:, None]], axis=1),
        np.concatenate([moves.durations[:, :-1], last.durations], axis=1),
    )


def timed(start: FloatArray, ends: FloatArray, rate: FloatArray, limits: MotionLimits) -> Moves:
    """Return the fastest sequences from `start` (2,) or (N, 2) to `ends` (N, k, 2) within all limits.

    `rate`: largest peak rate (rad/s, (N, 1)); limits of acceleration and of the arm may require slower moves.
    """
    before = np.concatenate([np.broadcast_to(start, (len(ends), 2))[:, None], ends[:, :-1]], axis=1)
    way = ends - before
    farthest = np.abs(way).max(axis=-1)
    duration = PEAK_RATE * farthest / rate
    duration = np.maximum(duration, np.sqrt(PEAK_ACCELERATION * farthest / (RATE_SHARE * limits.acceleration)))
    if limits.workspace is not None:
        duration = np.maximum(duration, _for_the_arm(way, limits))
    whole = np.ceil(np.maximum(duration, SHORTEST_S) / CALL_S - 1e-9)
    return Moves(start, ends, whole * CALL_S)


def _for_the_arm(way: FloatArray, limits: MotionLimits) -> FloatArray:
    """Return the time (s) that the arm needs: bounds of E's speed and acceleration from L1 dφ1 and L2 dφ12."""
    arm = limits.workspace
    assert arm is not None
    turned = np.cumsum(way, axis=-1)  # of each palm against the world
    reach = (np.abs(turned) * arm.geometry.palm_lengths).sum(axis=-1)
    curved = (turned**2 * arm.geometry.palm_lengths).sum(axis=-1)
    by_speed = PEAK_RATE * reach / (RATE_SHARE * arm.speed)
    by_bend = np.sqrt((PEAK_ACCELERATION * reach + PEAK_RATE**2 * curved) / (RATE_SHARE * arm.acceleration))
    needed: FloatArray = np.maximum(by_speed, by_bend)
    return needed


def _rates(random: np.random.Generator, count: int, limits: MotionLimits) -> FloatArray:
    fastest = max(RATE_SHARE * limits.rate, SLOWEST)
    rates: FloatArray = np.exp(random.uniform(math.log(SLOWEST), math.log(fastest), count))
    return rates


def range_of(limits: MotionLimits) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest (φ1, φ2) (rad) for ends of moves; the middle of a range that is too narrow."""
    low, high = np.array([(bound.low, bound.high) for bound in limits.joint_bounds]).T
    margin = np.minimum(POSE_MARGIN, (high - low) / 2)
    low, high = low + margin, high - margin
    return low, np.maximum(low, high)


def _inside(poses: FloatArray, limits: MotionLimits) -> FloatArray:
    """Clip poses (…, 2) to the limits."""
    low, high = range_of(limits)
    top = limits.top - POSE_MARGIN
    first = np.clip(poses[..., 0], low[0], min(high[0], top - low[1]))
    opening = np.clip(poses[..., 1], low[1], np.minimum(high[1], top - first))
    return np.stack([first, opening], axis=-1)
