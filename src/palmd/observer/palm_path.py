"""The palms' motion over a whole record, smoothed: at any time, from earlier and later reports. Pure."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from palmd.events import FloatArray, PalmSample
from palmd.model import smoothing
from palmd.observer.palms import (
    FIRST_ACCELERATION_SD,
    FIRST_RATE_SD,
    PLAN_ACCELERATION_SD,
    PLAN_RATE_SD,
    PLANNED_JERK,
    white_jerk,
)
from palmd.system.mechanism import JOINTS

UNPLANNED_JERK = 20.0  # rad/s³/√Hz without a plan: follows a planned stop; more only lets more noise through
_DRIFT = np.diag([0.0, 1e-8, 1e-8])
_FIRST: FloatArray = np.array([1.0, FIRST_RATE_SD**2, FIRST_ACCELERATION_SD**2])


@dataclass(frozen=True, slots=True)
class PalmPath:
    """Smoothed reports at times `t` (n): `state` (n, 3, joints) holds φ, ω, α (rad, rad/s, rad/s²) of each joint."""

    t: FloatArray
    state: FloatArray

    def at(self, times: FloatArray) -> FloatArray:
        """Angles, rates and accelerations of all joints at each of `times` (s): (len(times), 3·joints).

        Between reports the quintic through both neighbours; outside of them at constant acceleration.
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
        """For how long (s) both palms have been slower than `rate` (rad/s), at each of `times` (s).

        If they have been from the path's beginning, the rest starts at `since`, if that is earlier.
        """
        slow = np.asarray((np.abs(self.state[:, 1]) < rate).all(axis=1))
        start = np.where(slow, -np.inf, self.t)
        start = np.maximum.accumulate(start)
        start[np.isinf(start)] = min(since, float(self.t[0]))
        at = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 1)
        duration: FloatArray = np.where(slow[at], times - start[at], 0.0)
        return np.maximum(duration, 0.0)


def smoothed_path(samples: Sequence[PalmSample], angle_noise: float) -> PalmPath:
    """Forward Kalman filter and backward Rauch–Tung–Striebel pass over reports in time order, both palms at once.

    angle_noise: 1σ of a measured angle (rad). The model is driven by white jerk; the plan's rates and accelerations are
    used as readings where they are reported. Raises ValueError when there is no report.
    """
    if not samples:
        raise ValueError("no report of the palms' angles")
    t = np.array([sample.t_sample for sample in samples])
    missing = (math.nan,) * len(JOINTS)
    reported = np.array([(each.angles, each.rates or missing, each.accelerations or missing) for each in samples])
    dt, jerk = np.diff(t), np.where(np.isnan(reported[1:, 2, 0]), UNPLANNED_JERK, PLANNED_JERK)
    drift = np.moveaxis(white_jerk(dt) * jerk**2, -1, 0) + _DRIFT * dt[:, None, None]
    sd = np.array([angle_noise, PLAN_RATE_SD, PLAN_ACCELERATION_SD])
    return PalmPath(t, _smoothing()(dt, np.ascontiguousarray(drift), reported, sd))


Smoothing = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]
"""Returns the states (n, 3, joints). Arguments: the time between reports (n − 1), the covariance that each step adds (n
− 1, 3, 3), the reported values (n, 3, joints), NaN where a value is not reported, and 1σ of each (3)."""


@cache
def _smoothing() -> Smoothing:
    """The smoother in `model/palm_path.c`. Raises RuntimeError where its sizes are not those of the mechanism."""
    library = smoothing.library().opened()
    if list((ctypes.c_long * 2).in_dll(library, "palm_path_sizes")) != [3, len(JOINTS)]:
        raise RuntimeError("model/palm_path.c has other sizes than system/mechanism.py")
    call = library.smooth_path
    call.argtypes, call.restype = (ctypes.c_long, *(ctypes.c_void_p,) * 8), None

    def smoothed(dt: FloatArray, drift: FloatArray, reported: FloatArray, sd: FloatArray) -> FloatArray:
        x, predicted, gains = np.empty_like(reported), np.empty_like(reported), np.empty((len(reported), 3, 3))
        call(len(reported), *(each.ctypes.data for each in (dt, drift, reported, sd, _FIRST, x, predicted, gains)))
        return x

    return smoothed


def _quintic(a: FloatArray, b: FloatArray, step: FloatArray, t: FloatArray) -> FloatArray:
    """φ, ω, α at times `t` into steps from a to b, each (n, 3, joints) of φ, ω, α: the quintic through both ends."""
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
