"""Limits and plans of three palms in space; the joints are β, γ2 and γ3 (rad)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from palmd.config.three_palms import (
    ThreePalmsConfig,
    ThreePalmsLimitsConfig,
    TiltMoveSpec,
    TiltPlanSpec,
    TiltSineSpec,
)
from palmd.motion.joint_limits import JointLimits
from palmd.motion.joint_plan import compile_joint_plan, target_of
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import PlanForm, Trajectory
from palmd.motion.segments import Angles, MotionSegment, Move, Sine, growing_s
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
    return compile_joint_plan(spec, limits, middle_of(limits) if start is None else start, _segments_of)


def _segments_of(each: TiltMoveSpec | TiltSineSpec, pose: Angles) -> tuple[list[MotionSegment], Angles]:
    if isinstance(each, TiltMoveSpec):
        end = target_of(each.move, pose, math.radians)
        return [Move(pose, end, each.duration_s)], end
    sine = Sine(
        pose,
        tuple(math.radians(degrees or 0.0) for degrees in each.sine.each()),
        tuple(math.tau * hz for hz in each.frequencies_hz),
        growing_s(each.frequencies_hz, each.duration_s),
        each.duration_s,
    )
    return [sine], pose


PLANS = PlanForm(TiltPlanSpec, ThreePalmsLimitsConfig, TiltLimits.of, TiltLimits.over, compile_tilt_plan)
"""Plans of three palms in space."""
