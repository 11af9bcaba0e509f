"""Set-points for each cycle of the arm, from a plan or a jog, with a final limit check before they are sent.

Pure, and safe in the loop. Whatever is requested, a set-point is inside the limits and no farther from the one before
than the rate limit allows. If the arm has not followed, the set-points restart at its actual pose and return to the
path at a quarter of the rate limit or less, while the path is paused.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection

from palmd.daemon.jog import Jog
from palmd.daemon.poses import Poses
from palmd.devices.actuator import ArmPose, Pose
from palmd.events import PalmMotion
from palmd.motion.exploration import Exploration
from palmd.motion.kinematics import PoseError
from palmd.motion.limits import MotionLimits, Workspace
from palmd.motion.plan import PlanPlace, Trajectory
from palmd.motion.segments import Angles
from palmd.motion.trajectory_executor import MotionError, TrajectoryExecutor

CYCLE_S = 0.016
LONGEST_STEP_S = 2 * CYCLE_S
"""Longest time for which one set-point moves if earlier ones were not sent."""

CATCH_UP_SHARE = 0.25
NEAR_M, NEAR_RAD = 0.005, math.radians(3.0)
"""Distance of the set-point from a blocked arm after a retreat: the one from which a controller resumes."""

RETREAT_S = 0.2
"""Time for the set-point's retreat and standstill, in which the controller's own path comes to rest behind it."""

_ON_PATH = 1e-6  # rad: less than the wire's micrometre
_OUTSIDE = math.radians(0.03)  # how far outside the limits a pose may be for its noise alone


class SetPoints:
    """See the module. `commanded` is the motion of the last set-point, None while the arm is not commanded."""

    def __init__(self, poses: Poses, limits: MotionLimits, free: Collection[int] = ()) -> None:
        """`free` joints need not follow their set-points; restarts ignore their deviation."""
        self.poses, self._free = poses, free
        self.commanded: PalmMotion | None = None
        self.interventions = 0
        self.violated = False
        self._frozen = False
        self._held = False
        self._paused = False
        self._off_path = False
        self._twist = 0.0  # of the tool against palm 2 (rad), as found; it is taken back gently
        self._t_sent = -math.inf
        self._retreat: tuple[PalmMotion, float] | None = None  # where to, and until when (s)
        self._may_retreat = False  # once in each tracking
        self._next = PalmMotion.at_rest(limits.unknown)
        self._jog: Jog | None = None
        self.limits = limits
        self._executor = TrajectoryExecutor(limits)

    def set_workspace(self, workspace: Workspace | None) -> None:
        """Apply the workspace that the arm reported. Only while it is not commanded."""
        self.limits = dataclasses.replace(self.limits, workspace=workspace)
        self._executor = TrajectoryExecutor(self.limits)

    def nearest(self, pose: PalmMotion) -> PalmMotion:
        """The pose within the angle limits nearest to `pose`."""
        return self.limits.clamp_step(pose, pose, math.inf)

    def tracking_problems(self, pose: PalmMotion) -> list[str]:
        """Reasons against tracking from `pose`, in words; allows for the pose's noise."""
        inside = self.nearest(pose)
        where = pose if _distance(inside, pose) > _OUTSIDE else inside
        try:
            return self.limits.violations(where.angles)
        except PoseError as error:
            return [str(error)]

    # What to do

    def stand(self, actual: PalmMotion, pose: ArmPose, t: float) -> None:
        """Begin to command the arm at `t` (s): hold its actual pose, with the tool as in `pose`."""
        inside = self.nearest(actual)
        self._executor.stand(inside.angles)
        self._reset_to(actual, pose)
        self._t_sent = t
        self._jog = None
        self._may_retreat = True
        self._frozen = self._held = self._paused = self._off_path = self.violated = False

    def leave(self) -> None:
        """Stop commanding the arm and discard the plan."""
        self._retreat = None
        if self.commanded is not None:
            self._executor.stand(self.limits.unknown)
            self.commanded = None
            self._jog = None

    def start(self, trajectory: Trajectory) -> None:
        """Move to the trajectory's start and run it; raises MotionError."""
        self._end_jog()
        self._executor.start(trajectory)
        self._held = self._paused = False
        self._settle()

    def hold(self) -> None:
        """Stop along the path."""
        self._held = True
        self._settle()

    def resume(self) -> None:
        """Continue after a hold."""
        self._held = False
        self._settle()

    def freeze(self, frozen: bool) -> None:
        """Stop while the arm does not answer; the path continues automatically afterwards."""
        if frozen != self._frozen:
            self._frozen = frozen
            self._settle()

    def pause(self, paused: bool) -> None:
        """Stop along the path while an exploration requires it."""
        self._paused = paused
        self._settle()

    def conclude(self) -> None:
        """End the exploration after its last move: stay at its end."""
        self._executor.conclude()

    def discard_plan(self) -> None:
        """Discard the plan that is held."""
        self._executor.stop()

    def jog(self, steps: Angles, t: float, whole: Angles | None = None) -> str:
        """Shift the palms by small steps (rad) at `t` (s); returns the limits that clipped the step, in words.

        Raises MotionError, changing nothing, if the step is impossible. whole: the sum of this and all following steps
        (rad) if known: then all of it must be within the limits.
        """
        if self.commanded is None or self._off_path or self._frozen:
            raise MotionError("the arm does not follow yet")
        if self._executor.moving:
            raise MotionError("a plan is running: hold it first")
        jog = Jog(self._executor.motion, self.limits, t) if self._jog is None else self._jog
        try:
            if whole is not None:
                jog.check(whole)
            problems = jog.step(steps, t)
        except PoseError as error:
            raise MotionError(str(error)) from None
        clipped = "; ".join(problems)
        if clipped and not jog.moving:
            raise MotionError(clipped)
        if self._jog is None:
            self._executor.stop()
            self._jog = jog
        return clipped

    def restart_at(self, actual: PalmMotion, pose: ArmPose) -> None:
        """The arm did not follow: restart at its `actual` pose, with the tool as in `pose`."""
        last = actual if self.commanded is None else self.commanded
        pairs = enumerate(zip(actual.angles, last.angles, strict=True))
        self._reset_to(actual._replace(angles=tuple(b if joint in self._free else a for joint, (a, b) in pairs)), pose)
        self._off_path = True
        self._settle()

    def retreat(self, actual: PalmMotion, t: float) -> None:
        """The arm does not move: bring the set-point close to its `actual` pose, from `t` (s) on.

        Otherwise an arm that is released would jump to the set-point. The set-point keeps a small distance, because an
        arm whose encoder is frozen looks the same.
        """
        if self.commanded is None or not self._may_retreat:
            return
        self._may_retreat = False
        share = min(NEAR_M / max(self._distance_m(actual, self.commanded), NEAR_M), 1.0)
        goal = tuple(a + share * (c - a) for a, c in zip(actual.angles, self.commanded.angles, strict=True))
        self._retreat = PalmMotion.at_rest(goal), t + RETREAT_S

    def _distance_m(self, actual: PalmMotion, commanded: PalmMotion) -> float:
        """Distance of two poses (m); a rotation by `NEAR_RAD` counts as `NEAR_M`."""
        turned = _distance(actual, commanded) * NEAR_M / NEAR_RAD
        try:
            one, other = self.poses.pose(actual.angles), self.poses.pose(commanded.angles)
        except PoseError:
            return turned
        if isinstance(one, Pose) and isinstance(other, Pose):
            return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
        return turned

    # What is being done

    @property
    def retreating(self) -> bool:
        """Whether the set-point retreats to an arm that does not move, or has done so, until the arm is stopped."""
        return self._retreat is not None and self.commanded is not None

    def retreated(self, t: float) -> bool:
        """Whether the retreat is complete at `t` (s)."""
        return self._retreat is None or t >= self._retreat[1]

    @property
    def moving(self) -> bool:
        """Whether a plan or a jog is moving the palms."""
        return self._executor.moving or (self._jog is not None and self._jog.moving)

    @property
    def running(self) -> bool:
        """Whether a plan is running."""
        return self._executor.moving

    @property
    def held(self) -> bool:
        """Whether a plan is held."""
        return self._jog is None and self._executor.held

    @property
    def over(self) -> bool:
        """Whether the plan is complete."""
        return self._executor.done

    @property
    def exploration(self) -> tuple[Exploration, float] | None:
        """The exploration under way and its own time (s), None without one."""
        return None if self._jog is not None else self._executor.exploration

    @property
    def plan(self) -> str | None:
        """Name of the plan under way."""
        return self._executor.plan

    @property
    def place(self) -> PlanPlace | None:
        """Position in the plan."""
        return self._executor.place

    # Set-points

    def target(self, t: float) -> ArmPose | None:
        """The set-point for `t` (s); call `sent` when it has been sent. None before `stand`."""
        before = self.commanded
        if before is None:
            return None
        if self._retreat is not None:
            return self._retreat_step(before, self._retreat[0], t)
        desired = self._executor.advance(t) if self._jog is None else self._jog.advance(t)
        self.violated |= _distance(self.nearest(desired), desired) > _ON_PATH
        dt = min(max(t - self._t_sent, 0.0), LONGEST_STEP_S) * (CATCH_UP_SHARE if self._off_path else 1.0)
        motion = self.limits.clamp_step(before, desired, dt)
        on_path = _distance(motion, desired) < _ON_PATH
        if on_path == self._off_path:
            self.interventions += not on_path
            self._off_path = not on_path
            self._settle()
        untwist = CATCH_UP_SHARE * self.limits.rate * dt
        self._twist -= min(max(self._twist, -untwist), untwist)
        pose = self._pose(motion)
        if pose is None:
            self.violated = True
            motion = PalmMotion.at_rest(before.angles)
            pose = self._pose(motion, anywhere=True)
        self._next = motion
        return pose

    def _retreat_step(self, before: PalmMotion, goal: PalmMotion, t: float) -> ArmPose | None:
        """The next set-point of a retreat, or its goal.

        A late set-point does not make up for lost time: the retreat is at the rate limit, which would be exceeded.
        """
        motion = self.limits.clamp_step(before, goal, min(max(t - self._t_sent, 0.0), CYCLE_S))
        self._next = motion
        return self._pose(motion)

    def sent(self, t: float) -> PalmMotion:
        """The last target was sent at `t` (s); returns its motion."""
        self.commanded, self._t_sent = self._next, t
        return self._next

    def _pose(self, motion: PalmMotion, *, anywhere: bool = False) -> ArmPose | None:
        """The arm's pose for a motion; None if it is singular or outside the arm's workspace."""
        try:
            pose = self.poses.pose(motion.angles, self._twist)
        except PoseError:
            return None
        box = self.limits.workspace
        if anywhere or box is None or not isinstance(pose, Pose):
            return pose
        inside = box.x_min <= pose.x_m <= box.x_max and box.y_min <= pose.y_m <= box.y_max
        return pose if inside else None

    def _reset_to(self, actual: PalmMotion, pose: ArmPose) -> None:
        self.commanded = PalmMotion.at_rest(actual.angles)
        self._twist = self.poses.twist(pose, actual.angles)

    def _end_jog(self) -> None:
        if self._jog is not None:
            if self._jog.moving:
                raise MotionError("the palms are being jogged")
            self._executor.stand(self._jog.motion.angles)
            self._jog = None

    def _settle(self) -> None:
        """Hold the executor while anything requires it, resume it otherwise."""
        if self._held or self._frozen or self._paused or self._off_path:
            self._executor.hold(hard=self._held or self._frozen or self._off_path)
        elif self._executor.held:
            self._executor.resume()


def _distance(a: PalmMotion, b: PalmMotion) -> float:
    """The largest difference of the joint angles (rad); infinite if one is NaN."""
    differences = [abs(one - other) for one, other in zip(a.angles, b.angles, strict=True)]
    return math.inf if any(map(math.isnan, differences)) else max(differences)
