"""Executes a trajectory in path time, so that hold and resume keep the geometry of the path.

The command is q(tau), tau the path time, and u = dtau/dt the path speed: 0 standing, 1 as planned. With the
trajectory's ω = q′ and α = q″ the command has the rate ω·u and the acceleration α·u² + ω·u̇. A hold brings
u to 0 and a resume back to 1, as fast as the acceleration limit leaves room for u̇. As u never exceeds 1, a motion
within the limits at plan speed is within them at any lower speed, and u̇ = 0 is always allowed.
"""

from __future__ import annotations

import math

from palmd.events import PalmMotion
from palmd.motion.exploration import Exploration
from palmd.motion.kinematics import PoseError
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import PlanPlace, Trajectory, approach
from palmd.motion.segments import Angles, Move

LONGEST_STEP = 0.020  # s; after a longer pause between calls the motion is delayed and does not catch up
_AT_REST = 1e-9  # rad/s; an angle with a lower rate does not limit the change of path speed
_SPEED_RATE_MAX = 1000.0  # 1/s; where the path stands still, its speed may change within a step


class MotionError(ValueError):
    """A motion command that is impossible now; the message says why."""


class TrajectoryExecutor:
    """Computes the commanded motion of the palms at each instant. Pure, and safe in the loop.

    The pose is NaN until `stand` sets one. `start` takes about a millisecond, everything else microseconds.
    """

    def __init__(self, limits: MotionLimits) -> None:
        self._limits = limits
        self._t = math.nan
        self._motion = PalmMotion.at_rest(limits.unknown)
        self._trajectory: Trajectory | None = None
        self._approach = Move(limits.unknown, limits.unknown, 0.0)
        self._tau = 0.0
        self._speed = 0.0
        self._wanted_speed = 0.0
        self._stopping = False
        self._concluded = False
        self._hard = False

    @property
    def motion(self) -> PalmMotion:
        """The last command returned by `advance` (rad, s)."""
        return self._motion

    @property
    def moving(self) -> bool:
        """True while the command moves; a dwell within a running plan counts as moving."""
        return self._speed > 0.0 or self._wanted_speed > 0.0

    @property
    def held(self) -> bool:
        """True while a plan waits for `resume`."""
        return self._trajectory is not None and not self._stopping and self._wanted_speed == 0.0 and not self.done

    @property
    def done(self) -> bool:
        """True once the plan has reached its end."""
        return self._trajectory is not None and (self._concluded or self._tau >= self._end)

    @property
    def plan(self) -> str | None:
        """Name of the current plan; None without one."""
        return None if self._trajectory is None else self._trajectory.name

    @property
    def place(self) -> PlanPlace | None:
        """Position of the command in the plan; None without one."""
        if self._trajectory is None:
            return None
        if self._tau < self._approach.duration:
            return PlanPlace(0, "approach", 0.0)
        return self._trajectory.place(self._tau - self._approach.duration)

    @property
    def exploration(self) -> tuple[Exploration, float] | None:
        """The running exploration and its time (s); None if there is none or it is over."""
        lead = self._approach.duration
        if self._trajectory is None or self.done or self._tau < lead:
            return None
        return self._trajectory.exploration(self._tau - lead)

    def stand(self, angles: Angles) -> None:
        """Restart at the palms' actual pose (rad), without motion; only while the arm does not follow commands."""
        self._motion = PalmMotion.at_rest(angles)
        self._drop()

    def start(self, trajectory: Trajectory) -> None:
        """Go to the trajectory's start by a gentle minimum-jerk move, then run it.

        Raises MotionError while moving, without a pose, and if the way there leaves the limits.
        """
        if self.moving:
            raise MotionError("the palms are moving: hold or stop them first")
        present = self._motion.angles
        if any(map(math.isnan, present)):
            raise MotionError("the palms' pose is not known")
        try:
            self._approach = approach(present, trajectory.start, self._limits, trajectory.lead_in)
        except PoseError as error:
            raise MotionError(f"no way from here to the start of plan {trajectory.name}: {error}") from None
        self._trajectory = trajectory
        self._tau = 0.0
        self._speed = self._wanted_speed = 1.0  # at once: the way there starts at rest
        self._stopping = self._concluded = False

    def hold(self, *, hard: bool = False) -> None:
        """Slow down along the path to a stand; `resume` continues from there. `hard`: with the stop deceleration."""
        self._wanted_speed = 0.0
        self._hard = hard

    def resume(self) -> None:
        """Speed up along the path again; raises MotionError when no plan is held."""
        if not self.held:
            raise MotionError("no plan is being held")
        self._wanted_speed = 1.0

    def stop(self) -> None:
        """Slow down along the path to a stand and discard the plan."""
        self._wanted_speed = 0.0
        self._stopping = True
        if self._speed == 0.0:
            self._drop()

    def conclude(self) -> None:
        """End the plan here; only while the path is at rest, for example after an exploration's last move."""
        self._speed = self._wanted_speed = 0.0
        self._concluded = True

    def advance(self, t: float) -> PalmMotion:
        """Return the command for time t (s); calls may be irregular, an earlier t changes nothing."""
        elapsed = 0.0 if math.isnan(self._t) else t - self._t
        if elapsed < 0.0:
            return self._motion
        self._t = t
        if self._trajectory is not None and elapsed > 0.0 and self.moving:
            self._step(self._trajectory, min(elapsed, LONGEST_STEP))
        return self._motion

    @property
    def _end(self) -> float:
        return math.inf if self._trajectory is None else self._approach.duration + self._trajectory.duration

    def _step(self, trajectory: Trajectory, dt: float) -> None:
        speed_rate = self._speed_rate(trajectory, dt)
        changing = dt
        if speed_rate != 0.0:
            changing = min(dt, (self._wanted_speed - self._speed) / speed_rate)
        self._tau += self._speed * changing + 0.5 * speed_rate * changing * changing
        if changing < dt:
            self._speed = self._wanted_speed
            self._tau += self._speed * (dt - changing)
            speed_rate = 0.0
        else:
            self._speed += speed_rate * changing
        if self._tau >= self._end:
            self._tau, self._speed, self._wanted_speed, speed_rate = self._end, 0.0, 0.0, 0.0
        self._motion = self._on_path(trajectory, self._tau, self._speed, speed_rate)
        if self._stopping and self._speed == 0.0:
            self._drop()

    def _speed_rate(self, trajectory: Trajectory, dt: float) -> float:
        """Return u̇ (1/s) towards the wanted speed, within the limits at both ends and middle of a step.

        These are the acceleration limit, or the stops' limits while the palms are stopped hard.
        """
        change = self._wanted_speed - self._speed
        if change == 0.0:
            return 0.0
        speed_rate = math.copysign(_SPEED_RATE_MAX, change)
        for ahead in (0.0, 0.5 * dt, dt):
            duration = min(ahead, abs(change / speed_rate)) if speed_rate != 0.0 else ahead
            speed = self._speed + speed_rate * duration
            planned = self._plan_motion(trajectory, self._tau + 0.5 * (self._speed + speed) * duration)
            if self._hard and change < 0.0:
                speed_rate = max(speed_rate, -self._limits.hardest_slowing(planned, speed))
            else:
                speed_rate = self._limited(speed_rate, planned, speed)
        return speed_rate

    def _limited(self, speed_rate: float, planned: PalmMotion, speed: float) -> float:
        """Reduce u̇, without reversing it, so that |α·u² + ω·u̇| respects the acceleration limit on both palms."""
        most = self._limits.acceleration
        for omega, alpha in zip(planned.rates, planned.accelerations, strict=True):
            if abs(omega) > _AT_REST:
                used = alpha * speed * speed
                room = (most - math.copysign(used, used * omega * speed_rate)) / abs(omega)
                speed_rate = math.copysign(min(abs(speed_rate), max(room, 0.0)), speed_rate)
        return speed_rate

    def _plan_motion(self, trajectory: Trajectory, tau: float) -> PalmMotion:
        lead = self._approach.duration
        return self._approach.at(tau) if tau < lead else trajectory.at(tau - lead)

    def _on_path(self, trajectory: Trajectory, tau: float, speed: float, speed_rate: float) -> PalmMotion:
        planned = self._plan_motion(trajectory, tau)
        if speed == 1.0 and speed_rate == 0.0:
            return planned
        each = zip(planned.rates, planned.accelerations, strict=True)
        return PalmMotion(
            planned.angles,
            tuple(omega * speed for omega in planned.rates),
            tuple(alpha * speed * speed + omega * speed_rate for omega, alpha in each),
        )

    def _drop(self) -> None:
        self._trajectory = None
        self._speed = self._wanted_speed = 0.0
        self._stopping = self._concluded = False
