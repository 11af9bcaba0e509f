"""The joints' motion from their reports: noisy angles, and the plan's rates and accelerations if they are reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BPoly, CubicSpline, make_smoothing_spline
from scipy.linalg import solveh_banded

from palmd.events import FloatArray
from palmd.system.three_palms import PalmPlanes, palms_at

PLAN_DRIFT = 1e-4
"""Deviation of the joints from their plan, a random walk (rad/√s)."""

Curve = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class JointPath:
    """The joints' angles (rad), rates and accelerations as functions of time, each (T,) → (T, 3)."""

    start: float
    end: float
    angle: Curve
    rate: Curve
    acceleration: Curve

    def palms(self, t: FloatArray) -> PalmPlanes:
        """The palms at times t (T,)."""
        return palms_at(self.angle(t), self.rate(t), self.acceleration(t))


def joint_path(t: FloatArray, angle: FloatArray, plan: FloatArray | None, noise: float) -> JointPath:
    """Path from reports at increasing times t (T,): angles (T, 3) with 1σ `noise` (rad).

    plan: (T, 2, 3) rates and accelerations of the motion plan; without it the angles are smoothed.
    """
    if plan is None:
        smooth = make_smoothing_spline(t, angle)
        return JointPath(t[0], t[-1], smooth, smooth.derivative(), smooth.derivative(2))
    rate, acceleration = plan[:, 0], plan[:, 1]
    h = np.diff(t)[:, None]
    steps = 0.5 * h * (rate[1:] + rate[:-1]) + h**2 / 12 * (acceleration[:-1] - acceleration[1:])
    planned = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    course = BPoly.from_derivatives(t, np.stack([planned, rate, acceleration], axis=1))
    deviation = CubicSpline(t, _smoothed_walk(t, angle - planned, noise))
    return JointPath(t[0], t[-1], *(_sum(course.derivative(k), deviation.derivative(k)) for k in range(3)))


def _sum(one: Curve, other: Curve) -> Curve:
    return lambda t: one(t) + other(t)


def _smoothed_walk(t: FloatArray, y: FloatArray, noise: float) -> FloatArray:
    """Smooth readings y (T, 3) with 1σ `noise` of a random walk of `PLAN_DRIFT`."""
    weight = 1.0 / (PLAN_DRIFT**2 * np.diff(t))
    band = np.full((2, len(t)), noise**-2)
    band[0, :-1] += weight
    band[0, 1:] += weight
    band[1, :-1] = -weight
    band[1, -1] = 0.0
    smooth: FloatArray = solveh_banded(band, y / noise**2, lower=True)
    return smooth
