"""The emulated arm as a machine: its servo, and the palms' linkage between the arm and the fixed base. Pure.

Written apart from the host's kinematics on purpose. Here motion goes one way, from the arm to the palms: the
arm holds palm 2's far end E, palm 1's far end is hinged at the base B, and E = B − L1·t(φ1) + L2·t(φ12) with
t(φ) = (cos φ, sin φ). World frame and SI throughout; poses on the arm's side are in arm coordinates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from palmd.config.arms import AdeptConfig
from palmd.config.two_palms import Config
from palmd.devices.actuator import Pose
from palmd.events import PalmMotion

_MOST_COSINE = math.cos(math.radians(3.0))  # of the opening: beyond it the linkage hits its stops
_GIVE_S = 0.004  # in which what blocks an axis brings it to a stand
_SERVO_LAG_S = 0.016  # a bandwidth of some 20 Hz


@dataclass(frozen=True, slots=True)
class Linkage:
    """Lengths and fixed points (m, rad): base B, palm lengths, the arm's base and its yaw in the world."""

    base: tuple[float, float]
    palm1_length: float
    palm2_length: float
    arm: tuple[float, float]
    yaw: float
    _turn: tuple[float, float] = field(init=False, repr=False, compare=False)  # cos, sin of the yaw

    def __post_init__(self) -> None:
        object.__setattr__(self, "_turn", (math.cos(self.yaw), math.sin(self.yaw)))

    @property
    def lengths(self) -> tuple[float, float]:
        """Of the palm that is hinged to the base, and of the one that the arm holds."""
        return self.palm1_length, self.palm2_length

    @classmethod
    def from_config(cls, config: Config) -> Linkage:
        """The configured linkage; raises ValueError where no arm holds the palms."""
        rig, arm = config.rig, config.arm
        if not isinstance(arm, AdeptConfig):
            raise ValueError(f"arm.kind {arm.kind} has no linkage")
        return cls(
            (rig.base_mm[0] * 1e-3, rig.base_mm[1] * 1e-3),
            rig.palm1_length_mm * 1e-3,
            rig.palm2_length_mm * 1e-3,
            (arm.base_x_mm * 1e-3, arm.base_y_mm * 1e-3),
            math.radians(arm.base_yaw_deg),
        )

    def pose(self, phi1: float, phi2: float) -> Pose:
        """Where the arm is, in its own coordinates, when the palms stand at phi1, phi2 (rad)."""
        phi12 = phi1 + phi2
        x = self.base[0] - self.palm1_length * math.cos(phi1) + self.palm2_length * math.cos(phi12) - self.arm[0]
        y = self.base[1] - self.palm1_length * math.sin(phi1) + self.palm2_length * math.sin(phi12) - self.arm[1]
        c, s = self._turn
        return Pose(c * x + s * y, c * y - s * x, turn(phi12 - self.yaw))

    def angles(self, x: float, y: float) -> tuple[float, float] | None:
        """Palm angles for an arm position (m, arm coordinates); None where the linkage cannot be."""
        c, s = self._turn
        return self._angles_from_base(
            self.arm[0] + c * x - s * y - self.base[0], self.arm[1] + s * x + c * y - self.base[1]
        )

    def motion(self, x: tuple[float, float, float], y: tuple[float, float, float]) -> PalmMotion | None:
        """The palms' motion from the arm's (position, velocity, acceleration) along x and along y.

        Arm coordinates. The rates solve Ė = −L1·ω1·n(φ1) + L2·ω12·n(φ12), n(φ) = dt/dφ, the accelerations the
        same with the centripetal terms brought over. None where `angles` has none.
        """
        c, s = self._turn
        found = self._angles_from_base(
            self.arm[0] + c * x[0] - s * y[0] - self.base[0], self.arm[1] + s * x[0] + c * y[0] - self.base[1]
        )
        if found is None:
            return None
        phi1, phi2 = found
        phi12 = phi1 + phi2
        l1, l2 = self.palm1_length, self.palm2_length
        c1, s1, c12, s12 = math.cos(phi1), math.sin(phi1), math.cos(phi12), math.sin(phi12)
        sin_phi2 = s12 * c1 - c12 * s1
        vx, vy = c * x[1] - s * y[1], s * x[1] + c * y[1]
        omega1 = -(vx * c12 + vy * s12) / (l1 * sin_phi2)
        omega12 = -(vx * c1 + vy * s1) / (l2 * sin_phi2)
        ax = c * x[2] - s * y[2] - l1 * omega1**2 * c1 + l2 * omega12**2 * c12
        ay = s * x[2] + c * y[2] - l1 * omega1**2 * s1 + l2 * omega12**2 * s12
        alpha1 = -(ax * c12 + ay * s12) / (l1 * sin_phi2)
        alpha12 = -(ax * c1 + ay * s1) / (l2 * sin_phi2)
        return PalmMotion((phi1, phi2), (omega1, omega12 - omega1), (alpha1, alpha12 - alpha1))

    def _angles_from_base(self, dx: float, dy: float) -> tuple[float, float] | None:
        l1, l2 = self.palm1_length, self.palm2_length
        cos_phi2 = (l1 * l1 + l2 * l2 - dx * dx - dy * dy) / (2.0 * l1 * l2)
        if abs(cos_phi2) > _MOST_COSINE:
            return None
        phi2 = math.acos(cos_phi2)
        return turn(math.atan2(dy, dx) - math.atan2(l2 * math.sin(phi2), l2 * cos_phi2 - l1)), phi2


def turn(angle: float) -> float:
    """The angle (rad) brought into (−π, π]."""
    return -((math.pi - angle) % math.tau - math.pi)


class Servo:
    """One axis that follows straight pieces of path through a critically damped second-order lag.

    ẍ = k²·(r − x) − 2kẋ, solved in closed form on each piece, where r moves evenly: with e = x − r,
    e(τ) = e∞ + (A + Bτ)·exp(−kτ), e∞ = −2ṙ/k.
    """

    def __init__(self, position: float, lag_s: float = _SERVO_LAG_S) -> None:
        """At rest at `position`; at a steady speed it trails the path by `lag_s`."""
        self._k = 2.0 / lag_s
        self._t = 0.0
        self._r, self._r_dot = position, 0.0
        self._rest, self._a, self._b = 0.0, 0.0, 0.0
        self._blocked: tuple[float, float, float] | None = None  # since when (s), where and how fast it was then

    def block(self, t: float) -> None:
        """Something holds the axis from t (s) on, and gives a little; the path goes on."""
        x, v, _ = self.at(t)
        self._blocked = t, x, v

    def release(self, t: float) -> None:
        """Nothing holds it any more at t (s): it goes after the path from where it stood."""
        rate = self._r_dot
        self.follow(t, rate)
        self._blocked = None

    def follow(self, t: float, rate: float) -> None:
        """From t (s) on the path goes on from where it is at `rate` per second."""
        x, v, _ = self.at(t)
        start = self.goal(t)
        self._t, self._r, self._r_dot = t, start, rate
        self._rest = -2.0 * rate / self._k
        self._a = x - start - self._rest
        self._b = v - rate + self._k * self._a

    def goal(self, t: float) -> float:
        """Where the path is at t (s)."""
        return self._r + self._r_dot * (t - self._t)

    def at(self, t: float) -> tuple[float, float, float]:
        """Position, velocity, acceleration at t (s), not before the last `follow`."""
        if self._blocked is not None:
            t_held, held, speed = self._blocked
            gone = math.exp((t_held - t) / _GIVE_S)
            return held + speed * _GIVE_S * (1.0 - gone), speed * gone, -speed * gone / _GIVE_S
        k, tau = self._k, t - self._t
        decay = math.exp(-k * tau)
        b = self._b * decay
        swing = self._a * decay + b * tau
        return (
            self._r + self._r_dot * tau + self._rest + swing,
            self._r_dot + b - k * swing,
            k * (k * swing - 2.0 * b),
        )
