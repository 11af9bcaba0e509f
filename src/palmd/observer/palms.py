"""The palms' own motion between reports: angle, rate and acceleration at any time near the last report."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from palmd.events import FloatArray, Joints, PalmMotion, PalmSample
from palmd.system.mechanism import JOINTS

JERK = 200.0  # rad/s³/√Hz, of palms whose plan is not told: enough to follow a planned stop
TOLD_JERK = 1.0  # rad/s³/√Hz, of palms whose plan is
PLAN_RATE_SD = 2e-3  # rad/s, of the plan's rate as a description of the palms
PLAN_ACCELERATION_SD = 2e-2  # rad/s²
ROUNDING_S2 = 6e-5  # (8 ms)²: an arm that interpolates between set-points rounds a plan's bends off beside delaying it
CHANGED = 0.2  # of the jerks of the last second: how far a change of the plan since the last report is off, one-sigma
JERK_MEMORY_S = 1.0
FORGOTTEN_S = 0.5  # after which what was known of the motion helps no more
FIRST_RATE_SD, FIRST_ACCELERATION_SD = 0.5, 5.0
STILL = (0.0,) * len(JOINTS)


def white_jerk(dt: float | FloatArray) -> FloatArray:
    """Covariance that white jerk of density 1 adds to (φ, ω, α) in `dt` (s): (3, 3), or (3, 3, n) for n of them."""
    return np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )


# Readings of one place share what the pad is wrong about there, its rounding above all: while the palms rest they weigh
# less and less, one half after such a time.
RESTING_RAD_S, SHARED_AFTER_S = 2e-3, 1.0


def motion_of(values: FloatArray) -> PalmMotion:
    """The joints' angles, rates and accelerations, one after the other, as a value with names."""
    angles, rates, accelerations = (tuple(each) for each in values.reshape(3, -1).tolist())
    return PalmMotion(angles, rates, accelerations)


def repetitions(rested_s: FloatArray | float) -> FloatArray | float:
    """How many readings of a pad share one error when the palms have rested for so long: 1 while they move."""
    return 1.0 + rested_s / SHARED_AFTER_S


class TrackedPalms(Protocol):
    """The palms' motion by their reports so far; `jerk` (rad/s³) of each joint is the one the plan showed last."""

    jerk: FloatArray

    @property
    def known(self) -> bool:
        """Whether a report has come."""

    @property
    def t(self) -> float:
        """Time of the last report; -inf before the first."""

    @property
    def repeated(self) -> float:
        """The `repetitions` of what is read now."""

    def sd(self, t: float) -> tuple[FloatArray, FloatArray]:
        """One-sigma of both angles (rad) and of both rates (rad/s) at `t` (s)."""

    def feed(self, sample: PalmSample) -> None:
        """Fuse one report; reports older than the last one are ignored."""

    def at(self, t: float) -> FloatArray:
        """Angles, rates and accelerations of all joints at `t`, seconds on the samples' clock."""

    def motion(self, t: float) -> PalmMotion:
        """The same as a value with names."""


class PalmTracker:
    """A Kalman filter on (φ, ω, α) of each palm, with the plan's rates and accelerations where they are told.

    Between reports the jerk is the one the plan showed last. Pure and safe inside the loop. Its twin in C is
    `compiled_fusion.CompiledPalms`.
    """

    def __init__(self, angle_noise: float):
        """`angle_noise` is the one-sigma of a measured palm angle (rad)."""
        self._angle_variance = angle_noise**2
        self._t: float | None = None
        self._state = np.zeros((len(JOINTS), 3))  # palm × (φ, ω, α)
        self._P = np.zeros((3, 3))  # the same for both palms: they are read and told together
        self._plan: tuple[float, Joints] | None = None  # t, α
        self.jerk = np.zeros(len(JOINTS))
        self._liveliest = 0.0  # the largest jerk lately
        self._t_moved = 0.0  # when the palms turned last

    @property
    def known(self) -> bool:
        """Whether a report has come."""
        return self._t is not None

    @property
    def t(self) -> float:
        """Time of the last report; -inf before the first."""
        return -np.inf if self._t is None else self._t

    @property
    def repeated(self) -> float:
        """The `repetitions` of what is read now."""
        return float(repetitions(self.t - self._t_moved)) if self.known else 1.0

    def sd(self, t: float) -> tuple[FloatArray, FloatArray]:
        """One-sigma of both angles (rad) and of both rates (rad/s) at `t` (s).

        The arm rounds the plan off, and since the last report the plan may have turned.
        """
        age = t - self.t
        turned = CHANGED * self._liveliest
        angle = self._P[0, 0] + (ROUNDING_S2 * self._state[:, 2]) ** 2 + (turned * age**3 / 6) ** 2
        rate = self._P[1, 1] + (ROUNDING_S2 * self.jerk) ** 2 + (turned * age**2 / 2) ** 2
        return np.sqrt(angle), np.sqrt(rate)

    def feed(self, sample: PalmSample) -> None:
        """Fuse one report; reports older than the last one are ignored."""
        if self._t is None or sample.t_sample - self._t > FORGOTTEN_S:
            self._begin(sample)
            return
        dt = sample.t_sample - self._t
        if dt < 0:
            return
        self._state = self.at(sample.t_sample).reshape(3, len(JOINTS)).T.copy()
        F = np.array([[1.0, dt, dt**2 / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
        told = sample.accelerations is not None
        jerk = TOLD_JERK if told else JERK
        self._P = F @ self._P @ F.T + white_jerk(dt) * jerk**2 + np.diag([0.0, 1e-8, 1e-8]) * dt
        self._t = sample.t_sample
        self._liveliest = max(float(np.abs(self.jerk).max()), self._liveliest * math.exp(-dt / JERK_MEMORY_S))
        self._fuse(0, sample.angles, self._angle_variance)
        if sample.rates is not None:
            self._fuse(1, sample.rates, PLAN_RATE_SD**2)
        if sample.accelerations is not None:
            self._fuse(2, sample.accelerations, PLAN_ACCELERATION_SD**2)
            if self._plan is not None and sample.t_sample > self._plan[0]:
                t_before, before = self._plan
                self.jerk[:] = np.subtract(sample.accelerations, before) / (sample.t_sample - t_before)
            self._plan = (sample.t_sample, sample.accelerations)
        else:
            self.jerk[:] = 0.0
            self._plan = None
        if np.abs(self._state[:, 1]).max() > RESTING_RAD_S:
            self._t_moved = sample.t_sample

    def at(self, t: float) -> FloatArray:
        """Angles, rates and accelerations of all joints at `t`, seconds on the samples' clock."""
        # plain floats: several times faster than arrays of three
        dt = t - self.t
        half = dt * dt / 2
        sixth = half * dt / 3
        angles, rates, accelerations = [], [], []
        for (phi, omega, alpha), jerk in zip(self._state.tolist(), self.jerk.tolist(), strict=True):
            angles.append(phi + dt * omega + half * alpha + sixth * jerk)
            rates.append(omega + dt * alpha + half * jerk)
            accelerations.append(alpha + dt * jerk)
        return np.array([*angles, *rates, *accelerations])

    def motion(self, t: float) -> PalmMotion:
        """The same as a value with names."""
        return motion_of(self.at(t))

    def _begin(self, sample: PalmSample) -> None:
        self._t = self._t_moved = sample.t_sample
        self._state[:] = np.transpose([sample.angles, sample.rates or STILL, sample.accelerations or STILL])
        rate_sd = FIRST_RATE_SD if sample.rates is None else PLAN_RATE_SD
        acceleration_sd = FIRST_ACCELERATION_SD if sample.accelerations is None else PLAN_ACCELERATION_SD
        self._P[:] = np.diag([self._angle_variance, rate_sd**2, acceleration_sd**2])
        self._plan = None
        if sample.accelerations is not None:
            self._plan = (sample.t_sample, sample.accelerations)
        self.jerk[:] = 0.0
        self._liveliest = 0.0

    def _fuse(self, state: int, values: Joints, variance: float) -> None:
        spread = self._P[state, state] + variance
        k = self._P[:, state] / spread
        column = k[:, None]  # several times faster than np.outer
        self._state += (np.asarray(values) - self._state[:, state])[:, None] * k
        row = self._P[state].copy()
        self._P += column * k * spread - column * row - row[:, None] * k
