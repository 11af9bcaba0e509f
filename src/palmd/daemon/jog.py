"""Jogging: small steps of the palm angles with a dead-man time-out. Pure, and safe in the loop."""

from __future__ import annotations

import math

from palmd.events import Joints, PalmMotion
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import check_way

DEAD_MAN_S = 0.200
RATE = math.radians(10.0)
ACCELERATION = math.radians(100.0)
LEAD = math.radians(2.0)
"""How far the goal may be ahead of the palms."""


class Jog:
    """Moves at limited rate towards a goal that each step shifts; brakes to rest if no step arrives for 200 ms."""

    def __init__(self, pose: PalmMotion, limits: MotionLimits, t: float) -> None:
        """Begin at rest in `pose` at `t` (s)."""
        self._limits = limits
        self._q = list(pose.angles)
        self._v = [0.0] * len(self._q)
        self._goal = list(pose.angles)
        self._t = t
        self._t_alive = t
        self._rate = min(RATE, limits.rate)
        self._acceleration = min(ACCELERATION, limits.acceleration)

    @property
    def moving(self) -> bool:
        """Whether the palms are moving."""
        return any(self._v) or self._goal != self._q

    @property
    def motion(self) -> PalmMotion:
        """The commanded pose and rates."""
        return PalmMotion.at_rest(tuple(self._q))._replace(rates=tuple(self._v))

    def check(self, whole: Joints) -> None:
        """Raises PoseError if steps that add up to `whole` (rad) would leave the limits; takes about 1 ms."""
        end = tuple(goal + way for goal, way in zip(self._goal, whole, strict=True))
        check_way(tuple(self._goal), end, self._limits)

    def step(self, steps: Joints, t: float) -> list[str]:
        """Shift the goal by `steps` (rad) at `t` (s) as far as the limits allow; returns the limits that clipped it.

        A step that the limits block entirely changes nothing.
        """
        goal = [
            min(max(goal + step, q - LEAD), q + LEAD) for goal, step, q in zip(self._goal, steps, self._q, strict=True)
        ]
        problems = self._limits.violations(tuple(goal))
        if problems:
            goal = self._clipped(goal)
        if goal != self._goal or not problems:
            self._goal = goal
            self._t_alive = t
        return problems

    def _clipped(self, goal: list[float]) -> list[float]:
        """The point farthest from the present goal towards `goal` within the limits, to 1/256 of the way."""
        inside, share = self._goal, 0.5
        reached = 0.0
        for _ in range(8):
            candidate = [a + (reached + share) * (b - a) for a, b in zip(self._goal, goal, strict=True)]
            if not self._limits.violations(tuple(candidate)):
                inside, reached = candidate, reached + share
            share *= 0.5
        return list(inside)

    def advance(self, t: float) -> PalmMotion:
        """The motion at `t` (s)."""
        dt, self._t = min(max(t - self._t, 0.0), 0.02), max(t, self._t)
        alive = t - self._t_alive <= DEAD_MAN_S
        for i in range(len(self._q)):
            self._advance_one(i, dt, alive)
        self._keep_inside()
        return self.motion

    def _keep_inside(self) -> None:
        """Stop at a limit that braking would overshoot."""
        motion = self.motion
        inside = self._limits.clamp_step(motion, motion, math.inf).angles
        for i, (angle, limited) in enumerate(zip(motion.angles, inside, strict=True)):
            if angle != limited:
                self._q[i], self._v[i] = limited, 0.0

    def _advance_one(self, i: int, dt: float, alive: bool) -> None:
        max_change = self._acceleration * dt
        distance = self._goal[i] - self._q[i] if alive else 0.0
        brakes_from = math.sqrt(self._acceleration * abs(distance))  # half the braking rate allows a cycle's delay
        wanted = math.copysign(min(brakes_from, self._rate), distance) if distance else 0.0
        self._v[i] += min(max(wanted - self._v[i], -max_change), max_change)
        step = self._v[i] * dt
        if alive and abs(distance) <= max(abs(step), 1e-6) and abs(self._v[i]) <= 2.0 * max_change:
            self._q[i], self._v[i] = self._goal[i], 0.0
        else:
            self._q[i] += step
        if not alive and self._v[i] == 0.0:
            self._goal[i] = self._q[i]
