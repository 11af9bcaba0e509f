"""Limits and plans of three palms in space; the joints are β, γ2 and γ3 (rad)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from palmd.config.three_palms import (
    ThreePalmsConfig,
    ThreePalmsLimitsConfig,
    TiltAngles,
    TiltExploreSpec,
    TiltHoldSpec,
    TiltMoveSpec,
    TiltPlanSpec,
)
from palmd.events import PalmMotion
from palmd.motion.exploration import Exploration
from palmd.motion.joint_limits import JointLimits
from palmd.motion.limits import MotionLimits, problems, ranges
from palmd.motion.plan import Loc, PlanError, PlanForm, Round, Trajectory
from palmd.motion.segments import Angles, Hold, MotionSegment, Move, Sine, growing_s
from palmd.system.three_palms import JOINTS, SYSTEM


@dataclass(frozen=True, slots=True)
class TiltLimits(JointLimits):
    """Limits of the three joints."""

    system: ClassVar[str] = SYSTEM
    names: ClassVar[tuple[str, ...]] = JOINTS
    speeds: ClassVar[str] = "the rate of {}"
    accelerations: ClassVar[str] = "the acceleration of {}"
    unit: ClassVar[str] = "°"
    scale: ClassVar[float] = math.degrees(1.0)

    @classmethod
    def of(cls, config: ThreePalmsConfig) -> TiltLimits:
        """Configured limits in SI units."""
        return cls.over(config.limits, config.pads.palm1.length_mm)

    @classmethod
    def over(cls, limits: ThreePalmsLimitsConfig, pad_length_mm: float) -> TiltLimits:
        """Limits in SI units with pads of this length."""
        stop = limits.stop_deceleration_deg_s2
        return cls(
            angles=tuple((math.radians(low), math.radians(high)) for low, high in limits.ranges_deg),
            rate=math.radians(limits.rate_deg_s),
            acceleration=math.radians(limits.acceleration_deg_s2),
            pad_length=pad_length_mm * 1e-3,
            stop_deceleration=None if stop is None else math.radians(stop),
        )


def middle_of(limits: MotionLimits) -> Angles:
    """Start of a plan if the pose is not known: the middle of all ranges."""
    return tuple(0.5 * (low + high) for low, high in limits.angles)


def compile_tilt_plan(spec: TiltPlanSpec, limits: TiltLimits, start: Angles | None = None) -> Trajectory:
    """Compile a plan to a trajectory that begins at `start`; raises PlanError with all violations of the limits."""
    pose_now = start if start is not None else middle_of(limits)
    begin = pose = limits.clamp_step(PalmMotion.at_rest(pose_now), PalmMotion.at_rest(pose_now), math.inf).angles
    violations: list[tuple[Loc, str]] = []
    segments: list[MotionSegment] = []
    for index, each in enumerate(spec.segments):
        segment: MotionSegment
        if isinstance(each, TiltMoveSpec):
            end = _target(each.move, pose)
            segment, pose = Move(pose, end, each.duration_s), end
        elif isinstance(each, TiltHoldSpec):
            segment = Hold(pose, each.hold_s)
        elif isinstance(each, TiltExploreSpec):
            segment = Exploration(pose, each.explore)
            if index != len(spec.segments) - 1:
                text = "an exploration must be the last segment: its end is not known beforehand"
                violations.append((("segments", index), text))
        else:
            segment = Sine(
                pose,
                tuple(math.radians(degrees or 0.0) for degrees in each.sine.each()),
                tuple(math.tau * hz for hz in each.frequencies_hz),
                growing_s(each.frequencies_hz, each.duration_s),
                each.duration_s,
            )
        extremes = ranges(limits.values(segment.at(t)) for t in segment.sample_times())
        violations += [(("segments", index), text) for _, text in problems(limits.bounds, extremes)]
        segments.append(segment)
    if violations:
        raise PlanError(list(dict.fromkeys(violations)))
    whole = Round.of(segments)
    labels = tuple(next(iter(type(each).model_fields)) for each in spec.segments)
    return Trajectory(spec.name, begin, 0.0, whole.duration, labels, (whole,), None)


def _target(angles: TiltAngles, pose: Angles) -> Angles:
    targets = zip(angles.each(), pose, strict=True)
    return tuple(here if degrees is None else math.radians(degrees) for degrees, here in targets)


PLANS = PlanForm(TiltPlanSpec, ThreePalmsLimitsConfig, TiltLimits.of, TiltLimits.over, compile_tilt_plan)
"""Plans of three palms in space."""
