"""Rounds that tip objects with flat sides: as in the plan, within the limits, and with enough coverage."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from campaign import nightly

from palmd.config.two_palms import LimitsConfig, MoveSpec
from palmd.console.shipped import shipped
from palmd.motion.limits import MotionLimits, problems, ranges
from palmd.motion.segments import Angles, Move
from palmd.motion.tipping import POSES_DEG, pace_s, tip
from palmd.yamlfile import load_plan
from tools.studies.sharp_shapes import ArcSupport, rounded_polygon

LIMITS = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
SLOW = MotionLimits.from_config(LimitsConfig(rate_deg_s=40.0), pad_length=0.0555)
BINS = 72  # of normals
HOME: Angles = (math.radians(45.0), math.radians(90.0))
POSES: list[Angles] = [tuple(map(math.radians, pose)) for pose in POSES_DEG]


def test_the_shipped_plan_has_the_same_poses_and_durations() -> None:
    spec = load_plan(shipped("plans/tip.yaml"))
    moves = [segment for segment in spec.segments if isinstance(segment, MoveSpec)]
    assert [(move.move.phi1_deg, move.move.phi2_deg) for move in moves] == list(POSES_DEG)
    assert len(moves) == len(spec.segments)
    for number, move in enumerate(moves):
        assert move.duration_s == pytest.approx(pace_s(POSES[number - 1], POSES[number]), abs=0.06)


@pytest.mark.parametrize("limits", [LIMITS, SLOW])
def test_it_visits_all_poses_within_the_limits_and_repeats(limits: MotionLimits) -> None:
    here, aim, ends = HOME, None, []
    for _ in range(len(POSES) + 1):
        move = tip(here, aim, limits)
        assert move is not None
        assert move.start == here
        motion = ranges([limits.values(move.at(t)) for t in np.linspace(0.0, move.duration, 50)])
        assert not problems(limits.bounds, motion)
        assert move.duration >= pace_s(here, move.end)
        here = aim = move.end
        ends.append(here)
    assert ends == [*POSES, POSES[0]]


def test_after_a_stop_it_continues_to_the_same_pose() -> None:
    move = tip(POSES[4], POSES[4], LIMITS)
    assert move is not None
    stopped = tip(move.at(0.5 * move.duration).angles, move.end, LIMITS)
    assert stopped is not None
    assert move.end == stopped.end == POSES[5]


def shown(outline: ArcSupport, moves: Sequence[Move]) -> float:
    """The share of normals that touch a palm if the centre of mass is always at its lowest, without friction."""

    def normals(palms: Angles, psi: float) -> tuple[float, float]:
        return palms[0] - psi - math.pi / 2, sum(palms) - psi + math.pi / 2

    def downhill(palms: Angles, psi: float) -> float:
        one, two = (outline.at(theta)[1] for theta in normals(palms, psi))
        return one * math.sin(sum(palms)) + two * math.sin(palms[0])

    psi, bins = 0.0, set[int]()
    for move in moves:
        for t in np.arange(0.0, move.duration, 0.1).tolist():
            palms = move.at(t).angles
            way = math.copysign(5e-3, downhill(palms, psi))
            while downhill(palms, psi) * way > 0.0:
                psi += way
            bins |= {math.floor(theta / math.tau * BINS) % BINS for theta in normals(palms, psi)}
    return len(bins) / BINS


@pytest.mark.parametrize(
    ("corners", "reach_m"), [(3, 20e-3), (4, 11e-3), (6, 15e-3), *nightly((4, 13e-3), (5, 17e-3), (7, 18e-3))]
)
def test_two_rounds_touch_most_normals_of_objects_with_sides(corners: int, reach_m: float) -> None:
    ring = [reach_m * np.exp(2j * math.pi * k / corners) for k in range(corners)]
    outline = rounded_polygon([(z.real, z.imag) for z in ring], 1e-3)
    moves, here = list[Move](), POSES[-1]
    for _ in range(2 * len(POSES)):
        move = tip(here, here, LIMITS)
        assert move is not None
        moves.append(move)
        here = move.end
    assert shown(outline, moves) >= 0.8


def test_poses_outside_the_limits_are_skipped() -> None:
    wide = MotionLimits.from_config(LimitsConfig(phi2_deg=(100.0, 155.0)), pad_length=0.0555)
    here: Angles = (math.radians(30.0), math.radians(110.0))
    aim: Angles | None = None
    for _ in range(3):
        move = tip(here, aim, wide)
        assert move is not None
        here = aim = move.end
        assert here[1] >= math.radians(100.0)
    nowhere = MotionLimits.from_config(LimitsConfig(phi1_deg=(30.0, 31.0), phi2_deg=(90.0, 91.0)), pad_length=0.0555)
    assert tip((math.radians(30.5), math.radians(90.5)), None, nowhere) is None
