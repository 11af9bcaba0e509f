"""The emulated Adept arm of a pivoting grasp; its tool is the pivot. Pure."""

from __future__ import annotations

import math

import numpy as np

from palmd.config.pivot import PivotConfig
from palmd.devices.actuator import Pose
from palmd.rig.pivot import Axis
from palmd.rig.tool import DrivenTool, limits_around

_HEADROOM = 2.0  # ratio of the controller's limits to those that the gripper's limits require
_BELOW_M = 1e-3  # of its highest position, where the arm stands before the first command


class PivotArm(DrivenTool):
    """Its tool moves the pivot along and over the pad, or the lower stop of a slide on which the pivot can rise.

    travel: of the slide (m), which the controller's program adds to the reported position; 0 for a rigid gripper.
    """

    def __init__(self, config: PivotConfig, rng: np.random.Generator, *, step_s: float) -> None:
        """At rest in the middle over the pad, at the top; stepped every `step_s`."""
        arm, limits = config.arm, config.limits
        self._base = (arm.base_x_mm * 1e-3, arm.base_y_mm * 1e-3)
        self._turn = complex(math.cos(math.radians(arm.base_yaw_deg)), math.sin(math.radians(arm.base_yaw_deg)))
        self.travel = 0.0
        (x0, x1), (z0, z1) = ((low * 1e-3, high * 1e-3) for low, high in limits.ranges_mm)
        allowed = limits_around(
            [self._pose(x, z) for x in (x0, x1) for z in (z0, z1)],
            v_max=_HEADROOM * limits.speed_mm_s * 1e-3,
            a_max=2.0 * _HEADROOM * max(limits.acceleration_mm_s2, 1000.0) * 1e-3,
        )
        super().__init__(arm.baud, allowed, self._pose(0.5 * (x0 + x1), z1 - _BELOW_M), rng, step_s=step_s)

    def pivot_motion(self, t: float) -> tuple[Axis, Axis]:
        """Position, velocity, acceleration of the pivot, or of the slide's stop, along x and z."""
        (x, vx, ax), (y, vy, ay) = self._servos[0].at(t), self._servos[1].at(t)
        turn, (bx, by) = self._turn, self._base
        position, rate, acceleration = complex(x, y) * turn, complex(vx, vy) * turn, complex(ax, ay) * turn
        return (bx + position.real, rate.real, acceleration.real), (by + position.imag, rate.imag, acceleration.imag)

    def _true_pose(self, t: float) -> Pose:
        tool, lift = super()._true_pose(t), complex(0.0, self.travel) / self._turn
        return Pose(tool.x_m + lift.real, tool.y_m + lift.imag, tool.t_rad)

    def _pose(self, x: float, z: float) -> Pose:
        """The tool's pose, in arm coordinates, for a pivot at x along and z over the pad (m)."""
        position = complex(x - self._base[0], z - self._base[1]) / self._turn
        return Pose(position.real, position.imag, 0.0)
