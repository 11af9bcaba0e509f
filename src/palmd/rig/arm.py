"""Mechanics of the emulated arm: its axis servos, and the palms' linkage between the arm and the fixed base. Pure.

Implemented independently of the host's kinematics. Motion is computed in one direction, from the arm to the palms: the
arm holds palm 2's far end E, palm 1's far end is hinged at the base B, and E = B − L1·t(φ1) + L2·t(φ12) with
t(φ) = (cos φ, sin φ). World frame and SI units throughout; poses of the arm are in arm coordinates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from palmd.config.arms import AdeptConfig
from palmd.config.two_palms import Config
from palmd.devices.actuator import Pose
from palmd.events import PalmMotion

_MAX_COSINE = math.cos(math.radians(3.0))  # of the opening angle; beyond it the linkage is at its stops
_BLOCK_DECAY_S = 0.004  # time constant with which a blocked axis comes to rest
_SERVO_LAG_S = 0.016  # bandwidth of about 20 Hz


@dataclass(frozen=True, slots=True)
class Linkage:
    """Lengths and fixed points (m, rad): base B, palm lengths, the arm's base, and its yaw in the world."""

    base: tuple[float, float]
    palm1_length: float
    palm2_length: float
    arm: tuple[float, float]
    yaw: float
    _yaw_cos_sin: tuple[float, float] = field(init=False, repr=False, compare=False)  # cos, sin of the yaw

    def __post_init__(self) -> None:
        object.__setattr__(self, "_yaw_cos_sin", (math.cos(self.yaw), math.sin(self.yaw)))

    @property
    def lengths(self) -> tuple[float, float]:
        """Lengths of the palm hinged to the base, and of the palm that the arm holds (m)."""
        return self.palm1_length, self.palm2_length

    @classmethod
    def from_config(cls, config: Config) -> Linkage:
        """The configured linkage; raises ValueError for an actuator other than an Adept arm."""
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
        """The arm's pose, in arm coordinates, for palm angles phi1, phi2 (rad)."""
        phi12 = phi1 + phi2
        x = self.base[0] - self.palm1_length * math.cos(phi1) + self.palm2_length * math.cos(phi12) - self.arm[0]
        y = self.base[1] - self.palm1_length * math.sin(phi1) + self.palm2_length * math.sin(phi12) - self.arm[1]
        c, s = self._yaw_cos_sin
        return Pose(c * x + s * y, c * y - s * x, wrap_angle(phi12 - self.yaw))

    def angles(self, x: float, y: float) -> tuple[float, float] | None:
        """Palm angles for an arm position (m, arm coordinates); None where the linkage cannot reach."""
        c, s = self._yaw_cos_sin
        dx, dy = self.arm[0] + c * x - s * y - self.base[0], self.arm[1] + s * x + c * y - self.base[1]
        l1, l2 = self.palm1_length, self.palm2_length
        cos_phi2 = (l1 * l1 + l2 * l2 - dx * dx - dy * dy) / (2.0 * l1 * l2)
        if abs(cos_phi2) > _MAX_COSINE:
            return None
        phi2 = math.acos(cos_phi2)
        return wrap_angle(math.atan2(dy, dx) - math.atan2(l2 * math.sin(phi2), l2 * cos_phi2 - l1)), phi2

    def motion(self, x: tuple[float, float, float], y: tuple[float, float, float]) -> PalmMotion | None:
        """The palms' motion from the arm's (position, velocity, acceleration) along x and y, in arm coordinates.

        The rates solve Ė = −L1·ω1·n(φ1) + L2·ω12·n(φ12), n(φ) = dt/dφ; the accelerations solve its derivative. None
        where `angles` is None.
        """
        angles = self.angles(x[0], y[0])
        if angles is None:
            return None
        (c, s), (phi1, phi2) = self._yaw_cos_sin, angles
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


def wrap_angle(angle: float) -> float:
    """The angle (rad) wrapped into (−π, π]."""
    return -((math.pi - angle) % math.tau - math.pi)


class Servo:
    """One axis that follows a piecewise linear path through a critically damped second-order lag.

    ẍ = k²·(r − x) − 2kẋ, solved in closed form on each piece, where r changes at a constant rate: with e = x − r,
    e(τ) = e∞ + (A + Bτ)·exp(−kτ), e∞ = −2ṙ/k.
    """

    def __init__(self, position: float, lag_s: float = _SERVO_LAG_S) -> None:
        """At rest at `position`; at constant speed it trails the path by `lag_s`."""
        self._k = 2.0 / lag_s
        self._t = 0.0
        self._r, self._r_dot = position, 0.0
        self._rest, self._a, self._b = 0.0, 0.0, 0.0
        self._blocked: tuple[float, float, float] | None = None  # time (s), position and velocity when it was blocked

    def block(self, t: float) -> None:
        """Block the axis from t (s) on: it comes to rest exponentially while the path continues."""
        x, v, _ = self.at(t)
        self._blocked = t, x, v

    def release(self, t: float) -> None:
        """Release a blocked axis at t (s): it follows the path again from where it stands."""
        rate = self._r_dot
        self.follow(t, rate)
        self._blocked = None

    def follow(self, t: float, rate: float) -> None:
        """Continue the path from its present value at `rate` per second, from t (s) on."""
        x, v, _ = self.at(t)
        start = self.goal(t)
        self._t, self._r, self._r_dot = t, start, rate
        self._rest = -2.0 * rate / self._k
        self._a = x - start - self._rest
        self._b = v - rate + self._k * self._a

    def goal(self, t: float) -> float:
        """The path's value at t (s)."""
        return self._r + self._r_dot * (t - self._t)

    def at(self, t: float) -> tuple[float, float, float]:
        """Position, velocity and acceleration at t (s), not before the last `follow`."""
        if self._blocked is not None:
            t_held, position, speed = self._blocked
            decayed = math.exp((t_held - t) / _BLOCK_DECAY_S)
            return (
                position + speed * _BLOCK_DECAY_S * (1.0 - decayed),
                speed * decayed,
                -speed * decayed / _BLOCK_DECAY_S,
            )
        k, tau = self._k, t - self._t
        decay = math.exp(-k * tau)
        b = self._b * decay
        swing = self._a * decay + b * tau
        return (
            self._r + self._r_dot * tau + self._rest + swing,
            self._r_dot + b - k * swing,
            k * (k * swing - 2.0 * b),
        )
