"""Limits and plans of a pivoting gripper; its joints are the pivot's position x along the pad and z over it (m)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from palmd.config.pivot import PivotConfig, PivotLimitsConfig, PivotMoveSpec, PivotPlanSpec
from palmd.motion.joint_limits import JointLimits
from palmd.motion.joint_plan import compile_joint_plan, target_of
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import PlanForm, Trajectory
from palmd.motion.segments import Angles, MotionSegment, Move
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

    def segments_of(each: PivotMoveSpec, pose: Angles) -> tuple[list[MotionSegment], Angles]:
        end = target_of(each.move, pose, lambda mm: mm * 1e-3)
        return _legs(pose, end, each.duration_s), end

    return compile_joint_plan(spec, limits, pivot_home(limits) if start is None else start, segments_of)


def _legs(start: Angles, end: Angles, duration: float) -> list[MotionSegment]:
    """Legs up and along, or along and down; `duration` is shared in proportion to length; empty legs are left out."""
    corner = (start[0], end[1]) if end[1] > start[1] else (end[0], start[1])
    lengths = [max(abs(a - b) for a, b in zip(*leg, strict=True)) for leg in ((start, corner), (corner, end))]
    if not sum(lengths):
        return [Move(start, end, duration)]
    each = zip(((start, corner), (corner, end)), lengths, strict=True)
    return [Move(a, b, duration * length / sum(lengths)) for (a, b), length in each if length]


PLANS = PlanForm(PivotPlanSpec, PivotLimitsConfig, PivotLimits.of, PivotLimits.over, compile_pivot_plan)
"""Plans of a pivoting grasp."""
