"""Kinematics of the arc-hinge rig: palm angles ↔ arm position (frames: docs/theory/theory.md).

Palm 1's far end is hinged to the fixed base B; the arm holds palm 2's far end E:

    O = B − L1·(cos φ1, sin φ1)        E = O + L2·(cos φ12, sin φ12)        φ12 = φ1 + φ2

The distance D of E from B is given by D² = L1² + L2² − 2·L1·L2·cos φ2, so φ2 follows from D and φ1 from the direction;
φ2 is taken in (0, π), where the palms are open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.config.arms import AdeptConfig
from palmd.config.two_palms import Config
from palmd.events import Joints, PalmMotion
from palmd.system.mechanism import directions, hinge_position

LEAST_OPENING = math.radians(1.0)  # closer than this to φ2 = 0 or π, the singular poses, the arm cannot turn the palms


class PoseError(ValueError):
    """A pose that the rig cannot take, or that does not determine the palm angles."""


@dataclass(frozen=True, slots=True)
class RigGeometry:
    """Lengths and fixed points of the arc-hinge rig (m, rad), world frame.

    base_x, base_y: B. arm_x, arm_y, arm_yaw: the arm's base, yaw counted from the world X axis.
    """

    base_x: float
    base_y: float
    palm1_length: float
    palm2_length: float
    arm_x: float
    arm_y: float
    arm_yaw: float

    @property
    def palm_lengths(self) -> tuple[float, ...]:
        """Distance from the hinge to each palm's far end (m)."""
        return self.palm1_length, self.palm2_length

    @classmethod
    def from_config(cls, config: Config) -> RigGeometry:
        """Return the configured geometry in SI; raises PoseError for a rig without an arm that holds palm 2."""
        arm = config.arm
        if not isinstance(arm, AdeptConfig):
            raise PoseError(f"a rig with arm.kind: {arm.kind} has no arm that holds palm 2's end")
        base_x_mm, base_y_mm = config.rig.base_mm
        return cls(
            base_x=base_x_mm * 1e-3,
            base_y=base_y_mm * 1e-3,
            palm1_length=config.rig.palm1_length_mm * 1e-3,
            palm2_length=config.rig.palm2_length_mm * 1e-3,
            arm_x=arm.base_x_mm * 1e-3,
            arm_y=arm.base_y_mm * 1e-3,
            arm_yaw=math.radians(arm.base_yaw_deg),
        )

    def hinge(self, phi1: float) -> tuple[float, float]:
        """Return the hinge O in the world frame (m) for palm 1 at phi1 (rad)."""
        return hinge_position((self.base_x, self.base_y), self.palm1_length, phi1)

    def arm_pose(self, angles: Joints) -> tuple[float, float, float]:
        """Return position x, y (m, arm coordinates) and tool angle t (rad, in (−π, π]) for joint angles (rad).

        Raises PoseError where the palms are shut or stretched out, or not finite. Safe in the loop.
        """
        phi1, phi2 = angles
        _check_opening(phi2)
        phi12 = phi1 + phi2
        hinge_x, hinge_y = self.hinge(phi1)
        dx = hinge_x + self.palm2_length * math.cos(phi12) - self.arm_x
        dy = hinge_y + self.palm2_length * math.sin(phi12) - self.arm_y
        cos_yaw, sin_yaw = math.cos(self.arm_yaw), math.sin(self.arm_yaw)
        return cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx, wrapped(phi12 - self.arm_yaw)

    def palm_angles(self, x: float, y: float) -> Joints:
        """Return palm angles phi1 in (−π, π], phi2 in (0, π) (rad) for an arm position x, y (m, arm coordinates).

        Raises PoseError for a position out of palm 2's reach or singular. Safe in the loop.
        """
        cos_yaw, sin_yaw = math.cos(self.arm_yaw), math.sin(self.arm_yaw)
        dx = self.arm_x + cos_yaw * x - sin_yaw * y - self.base_x
        dy = self.arm_y + sin_yaw * x + cos_yaw * y - self.base_y
        l1, l2 = self.palm1_length, self.palm2_length
        cos_phi2 = (l1 * l1 + l2 * l2 - dx * dx - dy * dy) / (2.0 * l1 * l2)
        if not -1.0 <= cos_phi2 <= 1.0:  # also when it is NaN
            raise PoseError(
                f"the arm at x {x * 1e3:.1f} mm, y {y * 1e3:.1f} mm is {math.hypot(dx, dy) * 1e3:.1f} mm"
                f" from the palms' base; their lengths allow {abs(l1 - l2) * 1e3:.1f}"
                f" to {(l1 + l2) * 1e3:.1f} mm"
            )
        phi2 = math.acos(cos_phi2)
        _check_opening(phi2)
        toward_tip = math.atan2(l2 * math.sin(phi2), l2 * cos_phi2 - l1)  # direction B→E, counted from palm 1
        return wrapped(math.atan2(dy, dx) - toward_tip), phi2

    def tip_speed_acceleration(self, motion: PalmMotion) -> tuple[float, float]:
        """Return the magnitudes of speed (m/s) and acceleration (m/s²) of E, the point that the arm holds."""
        turned, turning, speeding = map(directions, (motion.angles, motion.rates, motion.accelerations))
        velocity, acceleration = [0.0, 0.0], [0.0, 0.0]
        # from B to the hinge along palm 1, and from there along palm 2
        for length, angle, omega, alpha in zip(
            (-self.palm1_length, self.palm2_length), turned, turning, speeding, strict=True
        ):
            along, across = length * math.cos(angle), length * math.sin(angle)
            velocity[0] -= across * omega
            velocity[1] += along * omega
            acceleration[0] -= across * alpha + along * omega**2
            acceleration[1] += along * alpha - across * omega**2
        return math.hypot(*velocity), math.hypot(*acceleration)


def wrapped(angle: float) -> float:
    """Wrap an angle (rad) to (−π, π]."""
    angle = math.remainder(angle, math.tau)
    return math.pi if angle == -math.pi else angle


def _check_opening(phi2: float) -> None:
    if not LEAST_OPENING <= phi2 <= math.pi - LEAST_OPENING:  # also when it is NaN
        raise PoseError(
            f"phi2 is {math.degrees(phi2):.2f}°: the palms are shut or stretched out and the arm cannot"
            f" turn them; phi2 must be {math.degrees(LEAST_OPENING):g}° to"
            f" {180 - math.degrees(LEAST_OPENING):g}°"
        )
