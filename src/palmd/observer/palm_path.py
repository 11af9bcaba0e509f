"""The palms' motion over a whole record, smoothed: what was it at any time, knowing also what came later. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray, PalmSample
from palmd.observer.palms import (
    FIRST_ACCELERATION_SD,
    FIRST_RATE_SD,
    PLAN_ACCELERATION_SD,
    PLAN_RATE_SD,
    TOLD_JERK,
    white_jerk,
)
from palmd.system.mechanism import JOINTS

UNTOLD_JERK = 20.0  # rad/s³/√Hz where no plan is told: follows a planned stop; more only lets more noise through
_DRIFT = np.diag([0.0, 1e-8, 1e-8])


@dataclass(frozen=True, slots=True)
class PalmPath:
    """Smoothed reports at times `t` (n): `state` (n, 3, joints) holds φ, ω, α (rad, rad/s, rad/s²) of each joint."""

    t: FloatArray
    state: FloatArray

    def at(self, times: FloatArray) -> FloatArray:
        """Angles, rates and accelerations of all joints at each of `times` (s): (len(times), 3·joints).

        Between reports the quintic that fits both neighbours; outside of them at constant acceleration.
        """
        after = np.clip(np.searchsorted(self.t, times, side="right"), 1, max(len(self.t) - 1, 1))
        first = np.minimum(after - 1, len(self.t) - 1)
        second = np.minimum(after, len(self.t) - 1)
        inside = np.clip(times, self.t[0], self.t[-1])
        step = np.maximum(self.t[second] - self.t[first], 1e-9)
        values = _quintic(self.state[first], self.state[second], step, inside - self.t[first])
        beyond = (times - inside)[:, None]
        phi, omega, alpha = values[:, 0], values[:, 1], values[:, 2]
        phi = phi + beyond * omega + beyond**2 / 2 * alpha
        return np.concatenate([phi, omega + beyond * alpha, alpha], axis=1)

    def resting(self, times: FloatArray, rate: float, since: float = math.inf) -> FloatArray:
        """For how long (s) both palms have turned slower than `rate` (rad/s) at each of `times` (s).

        Where they have from the path's beginning on, since `since` if that is earlier.
        """
        slow = np.asarray((np.abs(self.state[:, 1]) < rate).all(axis=1))
        began = np.where(slow, -np.inf, self.t)
        began = np.maximum.accumulate(began)
        began[np.isinf(began)] = min(since, float(self.t[0]))
        at = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 1)
        lasted: FloatArray = np.where(slow[at], times - began[at], 0.0)
        return np.maximum(lasted, 0.0)


def smoothed_path(samples: Sequence[PalmSample], angle_noise: float) -> PalmPath:
    """Forward Kalman filter and backward Rauch–Tung–Striebel pass over reports in time order, both palms at once.

    `angle_noise` is the one-sigma of a measured angle (rad). The model is driven by white jerk; the plan's rates and
    accelerations are readings where they are told. Raises ValueError when there is no report.
    """
    if not samples:
        raise ValueError("no report of the palms")
    t = np.array([sample.t_sample for sample in samples])
    n = len(t)
    x, P = np.zeros((n, 3, len(JOINTS))), np.zeros((n, 3, 3))
    x_pred, P_pred = np.zeros((n, 3, len(JOINTS))), np.zeros((n, 3, 3))
    jerk = np.array([UNTOLD_JERK if sample.accelerations is None else TOLD_JERK for sample in samples[1:]])
    transitions, drift = _steps(np.diff(t), jerk)
    for k, sample in enumerate(samples):
        if k == 0:
            x_pred[0, 0] = sample.angles
            P_pred[0] = np.diag([1.0, FIRST_RATE_SD**2, FIRST_ACCELERATION_SD**2])
        else:
            F = transitions[k - 1]
            x_pred[k] = F @ x[k - 1]
            P_pred[k] = F @ P[k - 1] @ F.T + drift[k - 1]
        x[k], P[k] = _fused(x_pred[k], P_pred[k], sample, angle_noise)
    gains = np.linalg.solve(P_pred[1:], transitions @ P[:-1]).swapaxes(1, 2)
    for k in range(n - 2, -1, -1):
        x[k] += gains[k] @ (x[k + 1] - x_pred[k + 1])
    return PalmPath(t, x)


def _steps(dt: FloatArray, jerk: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What (φ, ω, α) become in each `dt`, and the covariance that white `jerk` adds, each (n, 3, 3)."""
    transitions = np.tile(np.eye(3), (len(dt), 1, 1))
    transitions[:, 0, 1] = transitions[:, 1, 2] = dt
    transitions[:, 0, 2] = dt**2 / 2
    return transitions, np.moveaxis(white_jerk(dt) * jerk**2, -1, 0) + _DRIFT * dt[:, None, None]


def _fused(x: FloatArray, P: FloatArray, sample: PalmSample, angle_noise: float) -> tuple[FloatArray, FloatArray]:
    readings = (
        (sample.angles, angle_noise),
        (sample.rates, PLAN_RATE_SD),
        (sample.accelerations, PLAN_ACCELERATION_SD),
    )
    for row, (values, sd) in enumerate(readings):
        if values is None:
            continue
        spread = P[row, row] + sd**2
        gain = P[:, row] / spread
        x = x + gain[:, None] * (np.array(values) - x[row])
        P = P - gain[:, None] * gain * spread
    return x, P


def _quintic(a: FloatArray, b: FloatArray, step: FloatArray, t: FloatArray) -> FloatArray:
    """φ, ω, α at `t` into steps from a to b, each (n, 3, joints) of φ, ω, α: the quintic through both ends."""
    h, u = step[:, None], (t / step)[:, None]
    # in the normalised time u, with ends' derivatives scaled by the step
    p0, rate0, a0 = a[:, 0], a[:, 1] * h, a[:, 2] * h**2
    p1, rate1, a1 = b[:, 0], b[:, 1] * h, b[:, 2] * h**2
    miss_p, miss_v, miss_a = p1 - p0 - rate0 - a0 / 2, rate1 - rate0 - a0, a1 - a0
    c3 = 10 * miss_p - 4 * miss_v + miss_a / 2
    c4 = -15 * miss_p + 7 * miss_v - miss_a
    c5 = 6 * miss_p - 3 * miss_v + miss_a / 2
    phi = p0 + u * (rate0 + u * (a0 / 2 + u * (c3 + u * (c4 + u * c5))))
    omega = (rate0 + u * (a0 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))) / h
    alpha = (a0 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5))) / h**2
    return np.stack([phi, omega, alpha], axis=1)
