"""What a pivoting gripper may do, and its plans: the pivot's place x along the pad and z over it are the joints (m)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from palmd.config.pivot import (
    PivotConfig,
    PivotExploreSpec,
    PivotHoldSpec,
    PivotLimitsConfig,
    PivotMoveSpec,
    PivotPlanSpec,
    PivotTarget,
)
from palmd.events import PalmMotion
from palmd.motion.exploration import Exploration
from palmd.motion.joint_limits import JointLimits
from palmd.motion.limits import MotionLimits, problems, ranges
from palmd.motion.plan import Loc, PlanError, PlanForm, Round, Trajectory
from palmd.motion.segments import Angles, Hold, MotionSegment, Move
from palmd.system.pivot import AXES, SYSTEM


@dataclass(frozen=True, slots=True)
class PivotLimits(JointLimits):
    """Of the pivot's place: `angles` are the ranges of x and z (m), rate and acceleration in m/s.

    force: what the body may press on the pad (N). slides: the arm has but the lower stop of a slide, over which the
    pivot is carried by what it stands on.
    """

    system: ClassVar[str] = SYSTEM
    names: ClassVar[tuple[str, ...]] = AXES
    speeds: ClassVar[str] = "the speed along {}"
    accelerations: ClassVar[str] = "the acceleration along {}"
    unit: ClassVar[str] = " mm"
    scale: ClassVar[float] = 1e3

    force: float = math.inf
    slides: bool = False

    @classmethod
    def of(cls, config: PivotConfig) -> PivotLimits:
        """The configured limits in SI."""
        over_pad = cls.over(config.limits, config.pads.palm1.length_mm)
        return replace(over_pad, slides=config.rig.vertical == "float")

    @classmethod
    def over(cls, limits: PivotLimitsConfig, pad_length_mm: float) -> PivotLimits:
        """The limits in SI over a pad of this length."""
        stop = limits.stop_deceleration_mm_s2
        return cls(
            angles=tuple((low * 1e-3, high * 1e-3) for low, high in limits.ranges_mm),
            rate=limits.speed_mm_s * 1e-3,
            acceleration=limits.acceleration_mm_s2 * 1e-3,
            pad_length=pad_length_mm * 1e-3,
            stop_deceleration=None if stop is None else stop * 1e-3,
            force=limits.force_n,
        )


def pivot_home(limits: MotionLimits) -> Angles:
    """Where a plan is taken to begin while nobody knows: in the middle over the pad, as high as may be."""
    (x0, x1), (_, z1) = limits.angles
    return (0.5 * (x0 + x1), z1)


def compile_pivot_plan(spec: PivotPlanSpec, limits: PivotLimits, start: Angles | None = None) -> Trajectory:
    """The plan as a trajectory within the limits; raises PlanError with everything that stands against it.

    It begins where the gripper stands. A move rises before it goes along, and goes along before it sinks: a body that
    is raised straight trails its friction, and what is dragged sideways might wedge.
    """
    stands = start if start is not None else pivot_home(limits)
    begin = pose = limits.clamp_step(PalmMotion.at_rest(stands), PalmMotion.at_rest(stands), math.inf).angles
    found: list[tuple[Loc, str]] = []
    segments: list[MotionSegment] = []
    labels: list[str] = []
    for index, each in enumerate(spec.segments):
        count = len(segments)
        if isinstance(each, PivotExploreSpec):
            if index != len(spec.segments) - 1:
                text = "where an exploration ends is not known beforehand: it must be the last segment"
                found.append((("segments", index), text))
            segments.append(Exploration(pose, each.explore))
        elif isinstance(each, PivotHoldSpec):
            segments.append(Hold(pose, each.hold_s))
        else:
            end = _target(each.move, pose)
            segments += _legs(pose, end, each.duration_s)
            pose = end
        labels += [_label(each)] * (len(segments) - count)
        for segment in segments[count:]:
            extremes = ranges(limits.values(segment.at(t)) for t in segment.sample_times())
            found += [(("segments", index), text) for _, text in problems(limits.bounds, extremes)]
    if found:
        raise PlanError(list(dict.fromkeys(found)))
    whole = Round.of(segments)
    return Trajectory(spec.name, begin, 0.0, whole.duration, tuple(labels), (whole,), None)


def _legs(start: Angles, end: Angles, duration: float) -> list[Move]:
    """Up, along, or along, down, in so much time together, shared by their lengths; no leg that leads nowhere."""
    corner = (start[0], end[1]) if end[1] > start[1] else (end[0], start[1])
    ways = [max(abs(a - b) for a, b in zip(*leg, strict=True)) for leg in ((start, corner), (corner, end))]
    if not sum(ways):
        return [Move(start, end, duration)]
    each = zip(((start, corner), (corner, end)), ways, strict=True)
    return [Move(a, b, duration * way / sum(ways)) for (a, b), way in each if way]


def _target(place: PivotTarget, pose: Angles) -> Angles:
    wanted = (place.x_mm, place.z_mm)
    return tuple(here if mm is None else mm * 1e-3 for mm, here in zip(wanted, pose, strict=True))


def _label(spec: PivotMoveSpec | PivotHoldSpec | PivotExploreSpec) -> str:
    return next(iter(type(spec).model_fields))


PLANS = PlanForm(PivotPlanSpec, PivotLimitsConfig, PivotLimits.of, PivotLimits.over, compile_pivot_plan)
"""Of a pivoting grasp."""
