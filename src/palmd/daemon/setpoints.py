"""Where the arm should be in each of its cycles: plan or jog, and the last guard before the wire.

Pure, and safe in the loop. Whatever is asked for, a set-point from here is inside the limits and no farther
from the one before than the rate limit allows. Where the arm has not followed, the set-points begin again at
its actual pose and walk back to the path at a quarter of the rate limit or less; the path waits.
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
"""What one set-point may make up for when the one before was not sent."""

CATCH_UP_SHARE = 0.25
NEAR_M, NEAR_RAD = 0.005, math.radians(3.0)
"""How near to the arm a set-point may be left that does not follow: as near as a controller resumes from."""

RETREAT_S = 0.2
"""How long the set-point takes back and stands there, so that the controller's own path comes to rest behind it."""

_ON_PATH = 1e-6  # rad: less than the wire's micrometre
_OUTSIDE = math.radians(0.03)  # how far outside the limits a pose may be for its noise alone


class SetPoints:
    """See the module. `commanded` is the motion of the last set-point, None while the arm is not commanded."""

    def __init__(self, poses: Poses, limits: MotionLimits, free: Collection[int] = ()) -> None:
        """`free` joints need not be where they are commanded: they are displaced by nothing."""
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

    def learn(self, workspace: Workspace | None) -> None:
        """Take over what the arm has said it can do. Only while it is not commanded."""
        self.limits = dataclasses.replace(self.limits, workspace=workspace)
        self._executor = TrajectoryExecutor(self.limits)

    def nearest(self, pose: PalmMotion) -> PalmMotion:
        """The pose inside the angle limits that is nearest to `pose`."""
        return self.limits.clamp_step(pose, pose, math.inf)

    def may_stand(self, pose: PalmMotion) -> list[str]:
        """What speaks against tracking from `pose`, in words; its noise is allowed for."""
        inside = self.nearest(pose)
        where = pose if _distance(inside, pose) > _OUTSIDE else inside
        try:
            return self.limits.violations(where.angles)
        except PoseError as error:
            return [str(error)]

    # What to do

    def stand(self, actual: PalmMotion, pose: ArmPose, t: float) -> None:
        """The arm follows from now on, `t` (s); stand where it is, its tool as in its `pose`."""
        inside = self.nearest(actual)
        self._executor.stand(inside.angles)
        self._begin_at(actual, pose)
        self._t_sent = t
        self._jog = None
        self._may_retreat = True
        self._frozen = self._held = self._paused = self._off_path = self.violated = False

    def leave(self) -> None:
        """The arm no longer follows; the plan is put away."""
        self._retreat = None
        if self.commanded is not None:
            self._executor.stand(self.limits.unknown)
            self.commanded = None
            self._jog = None

    def start(self, trajectory: Trajectory) -> None:
        """Go to the trajectory's start and run it; raises MotionError."""
        self._end_jog()
        self._executor.start(trajectory)
        self._held = self._paused = False
        self._settle()

    def hold(self) -> None:
        """Come to a stand along the path."""
        self._held = True
        self._settle()

    def resume(self) -> None:
        """Go on after a hold."""
        self._held = False
        self._settle()

    def freeze(self, frozen: bool) -> None:
        """Stand still for as long as the arm does not answer; the path goes on by itself after that."""
        if frozen != self._frozen:
            self._frozen = frozen
            self._settle()

    def pause(self, paused: bool) -> None:
        """Come to a stand along the path for as long as an exploration wants it."""
        self._paused = paused
        self._settle()

    def conclude(self) -> None:
        """The exploration in hand is over, its last move done: stand where it ends."""
        self._executor.conclude()

    def put_away(self) -> None:
        """Forget the plan that is held."""
        self._executor.stop()

    def jog(self, steps: Angles, t: float, whole: Angles | None = None) -> str:
        """Shift the palms by small steps (rad) at `t` (s); returns which limits clipped the step, in words.

        Raises MotionError when it cannot be done at all, and changes nothing. whole: what this step and those to come
        add up to (rad), where it is known: then all of it must be possible.
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

    def displaced(self, actual: PalmMotion, pose: ArmPose) -> None:
        """The arm did not follow: begin again where it is, its tool as in its `pose`."""
        stood = actual if self.commanded is None else self.commanded
        pairs = enumerate(zip(actual.angles, stood.angles, strict=True))
        self._begin_at(actual._replace(angles=tuple(b if joint in self._free else a for joint, (a, b) in pairs)), pose)
        self._off_path = True
        self._settle()

    def retreat(self, actual: PalmMotion, t: float) -> None:
        """The arm does not move: bring the set-point back near to its `actual` pose from `t` (s) on.

        Else an arm that is released would spring to it. Not all the way, for an encoder that is frozen looks alike.
        """
        if self.commanded is None or not self._may_retreat:
            return
        self._may_retreat = False
        share = min(NEAR_M / max(self._apart(actual, self.commanded), NEAR_M), 1.0)
        goal = tuple(a + share * (c - a) for a, c in zip(actual.angles, self.commanded.angles, strict=True))
        self._retreat = PalmMotion.at_rest(goal), t + RETREAT_S

    def _apart(self, actual: PalmMotion, commanded: PalmMotion) -> float:
        """How far two poses are apart (m); turned by `NEAR_RAD` counts as `NEAR_M`."""
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
        """Whether the set-point goes back to an arm that does not move, or is there, until the arm is stopped."""
        return self._retreat is not None and self.commanded is not None

    def retreated(self, t: float) -> bool:
        """Whether by `t` (s) it has had time enough for that."""
        return self._retreat is None or t >= self._retreat[1]

    @property
    def moving(self) -> bool:
        """Whether a plan or a jog is under way."""
        return self._executor.moving or (self._jog is not None and self._jog.moving)

    @property
    def running(self) -> bool:
        """Whether a plan is under way."""
        return self._executor.moving

    @property
    def held(self) -> bool:
        """Whether a plan is waiting to go on."""
        return self._jog is None and self._executor.held

    @property
    def over(self) -> bool:
        """Whether the plan in hand has run to its end."""
        return self._executor.done

    @property
    def exploration(self) -> tuple[Exploration, float] | None:
        """The exploration in hand and its own time (s), None without one."""
        return None if self._jog is not None else self._executor.exploration

    @property
    def plan(self) -> str | None:
        """Name of the plan in hand."""
        return self._executor.plan

    @property
    def place(self) -> PlanPlace | None:
        """Where in the plan the motion is."""
        return self._executor.place

    # Set-points

    def target(self, t: float) -> ArmPose | None:
        """The set-point for `t` (s); tell with `sent` that it went out. None before `stand`."""
        before = self.commanded
        if before is None:
            return None
        if self._retreat is not None:
            return self._back(before, self._retreat[0], t)
        wanted = self._executor.advance(t) if self._jog is None else self._jog.advance(t)
        self.violated |= _distance(self.nearest(wanted), wanted) > _ON_PATH
        dt = min(max(t - self._t_sent, 0.0), LONGEST_STEP_S) * (CATCH_UP_SHARE if self._off_path else 1.0)
        motion = self.limits.clamp_step(before, wanted, dt)
        on_path = _distance(motion, wanted) < _ON_PATH
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

    def _back(self, before: PalmMotion, goal: PalmMotion, t: float) -> ArmPose | None:
        """The set-point on the way back, or where that ends.

        It makes up for nothing: all the way is at the rate limit, which a set-point that is late would exceed.
        """
        motion = self.limits.clamp_step(before, goal, min(max(t - self._t_sent, 0.0), CYCLE_S))
        self._next = motion
        return self._pose(motion)

    def sent(self, t: float) -> PalmMotion:
        """The last target went out at `t` (s); returns its motion."""
        self.commanded, self._t_sent = self._next, t
        return self._next

    def _pose(self, motion: PalmMotion, *, anywhere: bool = False) -> ArmPose | None:
        """The arm's pose for a motion; None where it is singular or outside the arm's workspace."""
        try:
            pose = self.poses.pose(motion.angles, self._twist)
        except PoseError:
            return None
        box = self.limits.workspace
        if anywhere or box is None or not isinstance(pose, Pose):
            return pose
        inside = box.x_min <= pose.x_m <= box.x_max and box.y_min <= pose.y_m <= box.y_max
        return pose if inside else None

    def _begin_at(self, actual: PalmMotion, pose: ArmPose) -> None:
        self.commanded = PalmMotion.at_rest(actual.angles)
        self._twist = self.poses.twist(pose, actual.angles)

    def _end_jog(self) -> None:
        if self._jog is not None:
            if self._jog.moving:
                raise MotionError("the palms are being jogged")
            self._executor.stand(self._jog.motion.angles)
            self._jog = None

    def _settle(self) -> None:
        """Make the executor wait while anything wants it to, and go on when nothing does."""
        if self._held or self._frozen or self._paused or self._off_path:
            self._executor.hold(hard=self._held or self._frozen or self._off_path)
        elif self._executor.held:
            self._executor.resume()


def _distance(a: PalmMotion, b: PalmMotion) -> float:
    """The larger difference of the palm angles (rad); infinite where one is not a number."""
    apart = [abs(one - other) for one, other in zip(a.angles, b.angles, strict=True)]
    return math.inf if any(map(math.isnan, apart)) else max(apart)
