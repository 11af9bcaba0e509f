"""Exploration paths: moves appended as they are decided, and the rocking at the start."""

from __future__ import annotations

import itertools
import math

import pytest

from palmd.config.plans import ExploreGoal
from palmd.config.two_palms import LimitsConfig
from palmd.motion.excitation import CORNERS_DEG, STEP_RAD, homewards, rock
from palmd.motion.exploration import Exploration
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import home
from palmd.motion.segments import Angles, Move

LIMITS = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
HERE: Angles = (0.8, 1.6)
THERE: Angles = (1.0, 1.5)
BEYOND: Angles = (0.9, 1.7)


def exploration() -> Exploration:
    return Exploration(HERE, ExploreGoal())


def angles(explored: Exploration, t: float) -> Angles:
    motion = explored.at(t)
    return motion.angles


def test_the_path_stands_at_its_start_until_a_move_is_appended() -> None:
    explored = exploration()
    assert angles(explored, 0.0) == angles(explored, 1e4) == HERE
    assert explored.end == 0.0
    move, elapsed = explored.under_way(3.0)
    assert move.end == HERE
    assert elapsed >= move.duration


def test_a_move_begins_when_it_is_appended_to_a_path_at_rest() -> None:
    explored = exploration()
    move = Move(HERE, THERE, 1.0)
    explored.append(move, 5.0)
    assert angles(explored, 4.9) == HERE
    for elapsed in (0.0, 0.25, 0.75, 1.0):
        assert explored.at(5.0 + elapsed) == move.at(elapsed)
    assert angles(explored, 100.0) == THERE
    assert explored.under_way(5.25) == (move, 0.25)


def test_a_move_waits_for_the_end_of_the_one_before() -> None:
    explored = exploration()
    first, second = Move(HERE, THERE, 1.0), Move(THERE, BEYOND, 0.5)
    explored.append(first, 2.0)
    explored.append(second, 2.4)
    assert explored.last == second
    assert explored.end == 3.5
    assert explored.at(2.5) == first.at(0.5)
    assert explored.under_way(2.9)[0] == first
    assert explored.at(3.25) == second.at(0.25)
    motions = [explored.at(2.0 + 0.01 * i) for i in range(170)]
    for a, b in itertools.pairwise(motions):  # no jump, and the rates are the derivatives of the angles
        assert b.angles[0] - a.angles[0] == pytest.approx(0.005 * (a.rates[0] + b.rates[0]), abs=1e-5)


def test_a_move_from_elsewhere_is_refused_and_changes_nothing() -> None:
    explored = exploration()
    explored.append(Move(HERE, THERE, 1.0), 0.0)
    with pytest.raises(ValueError, match="cannot follow"):
        explored.append(Move(HERE, BEYOND, 1.0), 0.5)
    assert angles(explored, 9.0) == THERE


def test_cut_drops_the_rest_of_the_move_and_all_after_it() -> None:
    explored = exploration()
    explored.append(Move(HERE, THERE, 1.0), 0.0)
    explored.append(Move(THERE, BEYOND, 1.0), 0.0)
    stood = angles(explored, 0.4)
    explored.cut(0.4)
    assert explored.end == 0.4
    assert angles(explored, 0.4) == angles(explored, 50.0) == stood
    explored.append(Move(stood, THERE, 1.0), 2.0)
    assert angles(explored, 1.9) == stood
    assert angles(explored, 3.0) == THERE


def test_cut_at_rest_changes_nothing() -> None:
    explored = exploration()
    explored.append(Move(HERE, THERE, 1.0), 0.0)
    explored.cut(1.5)
    assert explored.last == Move(HERE, THERE, 1.0)


def test_completed_moves_are_discarded() -> None:
    explored = exploration()
    for i in range(1000):
        explored.append(Move(explored.last.end, (HERE, THERE)[i % 2], 0.1), 0.1 * i)
    assert len(explored._moves) < 4


def test_rocking_is_gentle_and_visits_its_corners_and_returns() -> None:
    corners = [(HERE[0] + math.radians(a), HERE[1] + math.radians(b)) for a, b in CORNERS_DEG]
    here = HERE
    for corner in corners + corners:
        move = rock(here, HERE, LIMITS)
        assert move is not None
        assert (move.start, move.end) == (here, pytest.approx(corner))
        fastest = max(max(map(abs, m.rates)) for m in map(move.at, move.sample_times()))
        assert 0.0 < fastest <= 0.25 * LIMITS.rate * 1.001
        here = move.end


def test_rocking_skips_corners_beyond_the_limits_and_stops_without_any() -> None:
    edge = (LIMITS.angles[0][0] + math.radians(1.0), 1.6)
    here = edge
    for _ in range(4):
        move = rock(here, edge, LIMITS)
        assert move is not None
        assert move.end[0] > edge[0]
        here = move.end
    low = math.radians(45.0)
    narrow = MotionLimits(((low, low + 0.05), (1.5, 1.55)), LIMITS.rate, LIMITS.acceleration, LIMITS.pad_length)
    assert rock((low + 0.02, 1.52), (low + 0.02, 1.52), narrow) is None


def test_without_knowledge_the_palms_return_gently_to_the_home_pose() -> None:
    here, ways = (math.radians(125.0), math.radians(45.0)), 0
    while (move := homewards(here, LIMITS)) is not None:
        assert move.start == here
        assert max(abs(b - a) for a, b in zip(here, move.end, strict=True)) == pytest.approx(STEP_RAD)
        fastest = max(max(map(abs, m.rates)) for m in map(move.at, move.sample_times()))
        assert 0.0 < fastest <= 0.25 * LIMITS.rate * 1.001
        here, ways = move.end, ways + 1
    assert ways == 6
    assert max(abs(b - a) for a, b in zip(here, home(LIMITS), strict=True)) <= STEP_RAD
