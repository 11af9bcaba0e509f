"""The emulated actuator of three palms: its controller drives the joints directly, over the Adept's line. Pure.

The line's x and y carry β and γ2 in 1/1000 degree instead of µm, and t carries γ3.
"""

from __future__ import annotations

import math

import numpy as np

from palmd.config.three_palms import ThreePalmsConfig
from palmd.devices.actuator import Pose
from palmd.rig.three_palms.plant import JointMotion
from palmd.rig.tool import DrivenTool, limits_around

HEADROOM = 2.0  # ratio of the controller's limits to those required
ENCODER_NOISE_RAD = math.radians(0.015)
_PER_RAD = math.degrees(1e-3)


class TiltArm(DrivenTool):
    """Its tool coordinates are the joint angles."""

    def __init__(
        self, config: ThreePalmsConfig, home: tuple[float, ...], rng: np.random.Generator, *, step_s: float
    ) -> None:
        """At rest at `home` (rad); stepped every `step_s`."""
        limits = config.limits
        (b0, b1), (g0, g1), _ = (tuple(map(math.radians, ends)) for ends in limits.ranges_deg)
        allowed = limits_around(
            [_pose((b, g, 0.0)) for b in (b0, b1) for g in (g0, g1)],
            v_max=HEADROOM * math.sqrt(2.0) * limits.rate_deg_s * 1e-3,
            a_max=2.0 * HEADROOM * math.sqrt(2.0) * limits.acceleration_deg_s2 * 1e-3,
        )
        super().__init__(config.arm.baud, allowed, _pose(home), rng, step_s=step_s)

    def joints(self, t: float) -> JointMotion:
        """Angles, rates and accelerations of the joints at t (s), not before the last step."""
        first, second, last = self._servos
        axes = zip(first.at(t), second.at(t), last.at(t), strict=True)
        angles, rates, accelerations = [(x / _PER_RAD, y / _PER_RAD, angle) for x, y, angle in axes]
        return angles, rates, accelerations

    def _actual_pose(self, t: float) -> Pose:
        pose = super()._actual_pose(t)
        return Pose(pose.x_m, pose.y_m, pose.t_rad + float(self._rng.normal(0.0, ENCODER_NOISE_RAD)))


def _pose(joints: tuple[float, ...]) -> Pose:
    beta, gamma2, gamma3 = joints
    return Pose(beta * _PER_RAD, gamma2 * _PER_RAD, gamma3)
