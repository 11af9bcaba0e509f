"""The emulated arm of three palms: its controller drives the joints themselves, over the Adept's line. Pure.

The line's x and y carry β and γ2 in 1/1000 degree where an arm has µm, and t carries γ3.
"""

from __future__ import annotations

import math

import numpy as np

from palmd.config.three_palms import ThreePalmsConfig
from palmd.devices.actuator import Pose
from palmd.rig.three_palms.compiled import JointMotion
from palmd.rig.tool import DrivenTool, limits_round

ROOM = 2.0  # what the controller allows beyond what the limits need
ENCODER_NOISE_RAD = math.radians(0.015)
_PER_RAD = math.degrees(1e-3)


class TiltArm(DrivenTool):
    """Its tool are the joints."""

    def __init__(
        self, config: ThreePalmsConfig, home: tuple[float, ...], rng: np.random.Generator, *, step_s: float
    ) -> None:
        """At rest at `home` (rad); stepped every `step_s`."""
        limits = config.limits
        (b0, b1), (g0, g1), _ = (tuple(map(math.radians, ends)) for ends in limits.ranges_deg)
        allowed = limits_round(
            [_pose((b, g, 0.0)) for b in (b0, b1) for g in (g0, g1)],
            v_max=ROOM * math.sqrt(2.0) * limits.rate_deg_s * 1e-3,
            a_max=2.0 * ROOM * math.sqrt(2.0) * limits.acceleration_deg_s2 * 1e-3,
        )
        super().__init__(config.arm.baud, allowed, _pose(home), rng, step_s=step_s)

    def joints(self, t: float) -> JointMotion:
        """Where they are and how they move at t (s), no earlier than the last step."""
        first, second, last = self._servos
        along = zip(first.at(t), second.at(t), last.at(t), strict=True)
        angles, rates, accelerations = [(x / _PER_RAD, y / _PER_RAD, turned) for x, y, turned in along]
        return angles, rates, accelerations

    def _actual_pose(self, t: float) -> Pose:
        told = super()._actual_pose(t)
        return Pose(told.x_m, told.y_m, told.t_rad + float(self._rng.normal(0.0, ENCODER_NOISE_RAD)))


def _pose(joints: tuple[float, ...]) -> Pose:
    beta, gamma2, gamma3 = joints
    return Pose(beta * _PER_RAD, gamma2 * _PER_RAD, gamma3)
