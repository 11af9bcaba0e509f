"""Compile plans of independent joints: see `plan` for those of two palms, which repeat and have a dither."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from palmd.config.plans import AnyPlanSpec, ExploreSpec, HoldSpec, JointValues
from palmd.events import PalmMotion
from palmd.motion.exploration import Exploration
from palmd.motion.joint_limits import JointLimits
from palmd.motion.limits import problems, ranges
from palmd.motion.plan import Loc, PlanError, Round, Trajectory
from palmd.motion.segments import Angles, Hold, MotionSegment


def compile_joint_plan(
    spec: AnyPlanSpec,
    limits: JointLimits,
    start: Angles,
    segments_of: Callable[[Any, Angles], tuple[list[MotionSegment], Angles]],
) -> Trajectory:
    """Compile a plan to a trajectory that begins at `start`; raises PlanError with all violations of the limits.

    segments_of: segments of a specification, other than `hold_s` and `explore`, from a pose, and the pose at their end.
    """
    begin = pose = limits.clamp_step(PalmMotion.at_rest(start), PalmMotion.at_rest(start), math.inf).angles
    violations: list[tuple[Loc, str]] = []
    segments: list[MotionSegment] = []
    labels: list[str] = []
    for index, each in enumerate(spec.segments):
        added: list[MotionSegment]
        if isinstance(each, ExploreSpec):
            added = [Exploration(pose, each.explore)]
            if index != len(spec.segments) - 1:
                text = "an exploration must be the last segment: its end is not known beforehand"
                violations.append((("segments", index), text))
        elif isinstance(each, HoldSpec):
            added = [Hold(pose, each.hold_s)]
        else:
            added, pose = segments_of(each, pose)
        for segment in added:
            extremes = ranges(limits.values(segment.at(t)) for t in segment.sample_times())
            violations += [(("segments", index), text) for _, text in problems(limits.bounds, extremes)]
        segments += added
        labels += [next(iter(type(each).model_fields))] * len(added)
    if violations:
        raise PlanError(list(dict.fromkeys(violations)))
    whole = Round.of(segments)
    return Trajectory(spec.name, begin, 0.0, whole.duration, tuple(labels), (whole,), None)


def target_of(values: JointValues, pose: Angles, to_si: Callable[[float], float]) -> Angles:
    """The target of a move from `pose`: its values, converted by `to_si`; an omitted joint stays."""
    targets = zip(values.each(), pose, strict=True)
    return tuple(here if value is None else to_si(value) for value, here in targets)
