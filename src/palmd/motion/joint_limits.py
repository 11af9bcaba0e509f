"""Limits and plans of independent joints: a range for each, one speed and one acceleration for all."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from palmd.config.plans import AnyPlanSpec, ExploreSpec, HoldSpec
from palmd.events import Joints, PalmMotion
from palmd.motion.exploration import Exploration
from palmd.motion.limits import MotionLimits, QuantityLimit, clipped, problems
from palmd.motion.plan import Loc, PlanError, Round, Trajectory, extremes_of
from palmd.motion.segments import Angles, Hold, MotionSegment


@dataclass(frozen=True, slots=True)
class JointLimits(MotionLimits):
    """`MotionLimits` for independent joints; `angles`: their ranges, in rad or m."""

    names: ClassVar[tuple[str, ...]]
    """Names of the joints."""
    speeds: ClassVar[str]
    """Description of a rate, with {} for the joint's name."""
    accelerations: ClassVar[str]
    """Description of an acceleration, with {} for the joint's name."""
    unit: ClassVar[str]
    """Unit of positions in texts."""
    scale: ClassVar[float]
    """Factor from SI to that unit."""

    def __post_init__(self) -> None:
        """Set the bounds of each joint, of its speed and of its acceleration."""
        unit, scale = self.unit, self.scale
        bounds = [
            QuantityLimit(joint, unit, scale, low, high)
            for joint, (low, high) in zip(self.names, self.angles, strict=True)
        ]
        for order, what, per, most in (
            (1, self.speeds, "/s", self.rate),
            (2, self.accelerations, "/s²", self.acceleration),
        ):
            bounds += [QuantityLimit(what.format(joint), unit + per, scale, -most, most, order) for joint in self.names]
        object.__setattr__(self, "bounds", tuple(bounds))

    def values(self, motion: PalmMotion) -> tuple[float, ...]:
        """Return the quantities bounded by `bounds`, in that order."""
        return (*motion.angles, *motion.rates, *motion.accelerations)

    def _inside(self, angles: Joints) -> Joints:
        return clipped(angles, self.angles)


def compile_joint_plan(
    spec: AnyPlanSpec,
    limits: JointLimits,
    start: Angles,
    motions: Callable[[Any, Angles], tuple[Sequence[MotionSegment], Angles]],
) -> Trajectory:
    """Compile a plan to a trajectory that begins at `start`; raises PlanError with all violations of the limits.

    `motions` makes the segments of an entry of the plan other than a hold or an exploration, from its pose, and the
    pose at their end.
    """
    begin = pose = limits.clamp_step(PalmMotion.at_rest(start), PalmMotion.at_rest(start), math.inf).angles
    violations: list[tuple[Loc, str]] = []
    segments: list[MotionSegment] = []
    labels: list[str] = []
    for index, each in enumerate(spec.segments):
        if isinstance(each, ExploreSpec):
            if index != len(spec.segments) - 1:
                text = "an exploration must be the last segment: its end is not known beforehand"
                violations.append((("segments", index), text))
            own: Sequence[MotionSegment] = [Exploration(pose, each.explore)]
        elif isinstance(each, HoldSpec):
            own = [Hold(pose, each.hold_s)]
        else:
            own, pose = motions(each, pose)
        segments += own
        labels += [next(iter(type(each).model_fields))] * len(own)
        for segment in own:
            found = problems(limits.bounds, extremes_of(segment, limits))
            violations += [(("segments", index), text) for _, text in found]
    if violations:
        raise PlanError(list(dict.fromkeys(violations)))
    whole = Round.of(segments)
    return Trajectory(spec.name, begin, 0.0, whole.duration, tuple(labels), (whole,), None)
