"""Limits and plans of a pivoting gripper; its joints are the pivot's position x along the pad and z over it (m)."""

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
    """Limits of the pivot's position: `angles` are the ranges of x and z (m), rate in m/s, acceleration in m/s².

    force: limit of the body's force on the pad (N). slides: the arm commands only the lower stop of a slide; the body
    carries the pivot above it.
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
        """Configured limits in SI units."""
        over_pad = cls.over(config.limits, config.pads.palm1.length_mm)
        return replace(over_pad, slides=config.rig.vertical == "float")

    @classmethod
    def over(cls, limits: PivotLimitsConfig, pad_length_mm: float) -> PivotLimits:
        """Limits in SI units over a pad of this length."""
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
    """Start of a plan if the pose is not known: over the middle of the pad, as high as possible."""
    (x0, x1), (_, z1) = limits.angles
    return (0.5 * (x0 + x1), z1)


def compile_pivot_plan(spec: PivotPlanSpec, limits: PivotLimits, start: Angles | None = None) -> Trajectory:
    """Compile a plan to a trajectory that begins at `start`; raises PlanError with all violations of the limits.

    A move goes up before it goes along, and along before it goes down: a body that is raised straight trails behind its
    friction, and one that is dragged sideways might wedge.
    """
    pose_now = start if start is not None else pivot_home(limits)
    begin = pose = limits.clamp_step(PalmMotion.at_rest(pose_now), PalmMotion.at_rest(pose_now), math.inf).angles
    violations: list[tuple[Loc, str]] = []
    segments: list[MotionSegment] = []
    labels: list[str] = []
    for index, each in enumerate(spec.segments):
        count = len(segments)
        if isinstance(each, PivotExploreSpec):
            if index != len(spec.segments) - 1:
                text = "an exploration must be the last segment: its end is not known beforehand"
                violations.append((("segments", index), text))
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
            violations += [(("segments", index), text) for _, text in problems(limits.bounds, extremes)]
    if violations:
        raise PlanError(list(dict.fromkeys(violations)))
    whole = Round.of(segments)
    return Trajectory(spec.name, begin, 0.0, whole.duration, tuple(labels), (whole,), None)


def _legs(start: Angles, end: Angles, duration: float) -> list[Move]:
    """Legs up and along, or along and down; `duration` is shared in proportion to length; empty legs are left out."""
    corner = (start[0], end[1]) if end[1] > start[1] else (end[0], start[1])
    lengths = [max(abs(a - b) for a, b in zip(*leg, strict=True)) for leg in ((start, corner), (corner, end))]
    if not sum(lengths):
        return [Move(start, end, duration)]
    each = zip(((start, corner), (corner, end)), lengths, strict=True)
    return [Move(a, b, duration * length / sum(lengths)) for (a, b), length in each if length]


def _target(place: PivotTarget, pose: Angles) -> Angles:
    target = (place.x_mm, place.z_mm)
    return tuple(here if mm is None else mm * 1e-3 for mm, here in zip(target, pose, strict=True))


def _label(spec: PivotMoveSpec | PivotHoldSpec | PivotExploreSpec) -> str:
    return next(iter(type(spec).model_fields))


PLANS = PlanForm(PivotPlanSpec, PivotLimitsConfig, PivotLimits.of, PivotLimits.over, compile_pivot_plan)
"""Plans of a pivoting grasp."""
