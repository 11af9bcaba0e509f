"""The palms' motion between reports: angle, rate and acceleration at any time near the last report."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from palmd.events import FloatArray, Joints, PalmMotion, PalmSample
from palmd.system.mechanism import JOINTS

JERK = 200.0  # rad/s³/√Hz, white jerk of palms without a known plan: enough to follow a planned stop
PLANNED_JERK = 1.0  # rad/s³/√Hz, white jerk of palms with a known plan
PLAN_RATE_SD = 2e-3  # rad/s, 1σ of the plan's rate as a measurement of the palms
PLAN_ACCELERATION_SD = 2e-2  # rad/s², the same for the plan's acceleration
ROUNDING_S2 = 6e-5  # (8 ms)²: an arm that interpolates between set-points delays a plan and rounds its bends
CHANGED = 0.2  # 1σ of a change of the plan since the last report, relative to the largest jerk of the last second
JERK_MEMORY_S = 1.0  # decay time of the largest jerk
FORGOTTEN_S = 0.5  # gap between reports after which the tracker is re-initialised
FIRST_RATE_SD, FIRST_ACCELERATION_SD = 0.5, 5.0  # rad/s, rad/s²; initial 1σ without a plan
STILL = (0.0,) * len(JOINTS)


def white_jerk(dt: float | FloatArray) -> FloatArray:
    """Covariance that white jerk of density 1 adds to (φ, ω, α) in `dt` (s): (3, 3), or (3, 3, n) for n intervals."""
    return np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )


# Readings at one position share the pad's error there, its rounding above all: while the palms rest (rates below
# RESTING_RAD_S) their weight decreases, to one half after SHARED_AFTER_S.
RESTING_RAD_S, SHARED_AFTER_S = 2e-3, 1.0


def motion_of(values: FloatArray) -> PalmMotion:
    """A `PalmMotion` from the joints' angles, rates and accelerations in one array."""
    angles, rates, accelerations = (tuple(each) for each in values.reshape(3, -1).tolist())
    return PalmMotion(angles, rates, accelerations)


def repetitions(rested_s: FloatArray | float) -> FloatArray | float:
    """How many readings of a pad share one error after the palms have rested for `rested_s`; 1 while they move."""
    return 1.0 + rested_s / SHARED_AFTER_S


class TrackedPalms(Protocol):
    """The palms' motion estimated from their reports so far; `jerk` (rad/s³): each joint's last jerk by the plan."""

    jerk: FloatArray

    @property
    def known(self) -> bool:
        """Whether a report has been fused."""

    @property
    def t(self) -> float:
        """Time of the last report; -inf before the first."""

    @property
    def repeated(self) -> float:
        """The `repetitions` of readings at the last report's time."""

    def sd(self, t: float) -> tuple[FloatArray, FloatArray]:
        """1σ of both angles (rad) and of both rates (rad/s) at `t` (s).

        Includes the arm's rounding of the plan, and a possible change of the plan since the last report.
        """

    def feed(self, sample: PalmSample) -> None:
        """Fuse one report; reports older than the last one are ignored."""

    def at(self, t: float) -> FloatArray:
        """Angles, rates and accelerations of all joints at `t`, seconds on the samples' clock."""

    def motion(self, t: float) -> PalmMotion:
        """The same as a `PalmMotion`."""


class PalmTracker:
    """A Kalman filter on (φ, ω, α) of each palm, which also fuses the plan's rates and accelerations if known.

    A `TrackedPalms`. Between reports the jerk is the plan's last one. Pure and safe inside the loop.
    """

    def __init__(self, angle_noise: float):
        """`angle_noise`: 1σ of a measured palm angle (rad)."""
        self._angle_variance = angle_noise**2
        self._t: float | None = None
        self._state = np.zeros((len(JOINTS), 3))  # palm × (φ, ω, α)
        self._P = np.zeros((3, 3))  # the same for both palms: their reports come together
        self._plan: tuple[float, Joints] | None = None  # t, α
        self.jerk = np.zeros(len(JOINTS))
        self._largest_jerk = 0.0  # decays with JERK_MEMORY_S
        self._t_moved = 0.0  # when the palms moved last

    @property
    def known(self) -> bool:
        return self._t is not None

    @property
    def t(self) -> float:
        return -np.inf if self._t is None else self._t

    @property
    def repeated(self) -> float:
        return float(repetitions(self.t - self._t_moved)) if self.known else 1.0

    def sd(self, t: float) -> tuple[FloatArray, FloatArray]:
        age = t - self.t
        changed = CHANGED * self._largest_jerk
        angle = self._P[0, 0] + (ROUNDING_S2 * self._state[:, 2]) ** 2 + (changed * age**3 / 6) ** 2
        rate = self._P[1, 1] + (ROUNDING_S2 * self.jerk) ** 2 + (changed * age**2 / 2) ** 2
        return np.sqrt(angle), np.sqrt(rate)

    def feed(self, sample: PalmSample) -> None:
        if self._t is None or sample.t_sample - self._t > FORGOTTEN_S:
            self._begin(sample)
            return
        dt = sample.t_sample - self._t
        if dt < 0:
            return
        self._state = self.at(sample.t_sample).reshape(3, len(JOINTS)).T.copy()
        F = np.array([[1.0, dt, dt**2 / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
        planned = sample.accelerations is not None
        jerk = PLANNED_JERK if planned else JERK
        self._P = F @ self._P @ F.T + white_jerk(dt) * jerk**2 + np.diag([0.0, 1e-8, 1e-8]) * dt
        self._t = sample.t_sample
        self._largest_jerk = max(float(np.abs(self.jerk).max()), self._largest_jerk * math.exp(-dt / JERK_MEMORY_S))
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
        self._largest_jerk = 0.0

    def _fuse(self, state: int, values: Joints, variance: float) -> None:
        spread = self._P[state, state] + variance
        k = self._P[:, state] / spread
        column = k[:, None]  # several times faster than np.outer
        self._state += (np.asarray(values) - self._state[:, state])[:, None] * k
        row = self._P[state].copy()
        self._P += column * k * spread - column * row - row[:, None] * k
