"""Path of the pivot: measured positions smoothed with the velocities of the motion plan. Pure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, CubicHermiteSpline, PPoly, make_lsq_spline, make_smoothing_spline

from palmd.events import FloatArray

WINDOW_S = 0.5  # window of the means by which a deviation from the plan is detected
DEVIATION_CELL_S = 1.0  # cell of the spline that then models the deviation; a finer one would follow the noise
DEVIATION_SD = 3.0  # standard deviations of the windows' mean square above its expectation from noise
LEAST_SAMPLES = 8
LAG_CHI2 = 25.0  # χ² above which the arm's lag behind its plan is applied
OUTLIER = 4.0  # standard deviations
GAP = 4.0  # in median sampling intervals


@dataclass(frozen=True, slots=True)
class AxisPath:
    """Position, velocity and acceleration along one axis as functions of time, and the position's 1σ (m)."""

    position: CubicHermiteSpline | PPoly
    velocity: CubicHermiteSpline | PPoly
    acceleration: PPoly
    sd: float

    def at(self, t: FloatArray) -> FloatArray:
        """(position, velocity, acceleration) at times t (n): (3, n)."""
        return np.stack([self.position(t), self.velocity(t), self.acceleration(t)])


def axis_path(
    t: FloatArray, measured: FloatArray, rate: Sequence[float | None], second: Sequence[float | None], noise: float
) -> AxisPath:
    """Path through positions `measured` (m) with this `noise`.

    t: strictly increasing (s), at least `LEAST_SAMPLES`. rate, second: velocities and accelerations of the plan; if any
    is None, the positions are smoothed without a plan.
    """
    if any(each is None for each in (*rate, *second)):
        path = PPoly.from_spline(make_smoothing_spline(t, measured))
        return AxisPath(path, path.derivative(), path.derivative(2), noise / 3)
    v, a = np.array(rate, dtype=np.float64), np.array(second, dtype=np.float64)
    dt = np.diff(t)
    steps = (v[:-1] + v[1:]) * dt / 2 + (a[:-1] - a[1:]) * dt**2 / 12
    planned = np.concatenate([[0.0], np.cumsum(steps)])
    position = np.empty_like(planned)
    sd = noise / math.sqrt(len(t))
    for piece in _pieces(t):  # the velocity in a gap is not known
        deviation = measured[piece] - planned[piece]
        middle = float(np.median(deviation))
        deviation = np.clip(deviation, middle - OUTLIER * noise, middle + OUTLIER * noise)
        if _deviates(t[piece], deviation - deviation.mean(), noise):
            deviation_spline = _uniform_spline(t[piece], measured[piece] - planned[piece])
            position[piece] = planned[piece] + deviation_spline(t[piece])
            v[piece] += deviation_spline(t[piece], 1)
            a[piece] += deviation_spline(t[piece], 2)
            sd = max(sd, noise / math.sqrt(DEVIATION_CELL_S / float(np.median(dt))))
        else:
            position[piece] = planned[piece] + deviation.mean()
    _apply_servo_lag(t, measured, position, v, a, noise)
    velocity = CubicHermiteSpline(t, v, a)
    return AxisPath(CubicHermiteSpline(t, position, v), velocity, velocity.derivative(), sd)


def _apply_servo_lag(
    t: FloatArray, measured: FloatArray, position: FloatArray, v: FloatArray, a: FloatArray, noise: float
) -> None:
    """Correct the plan (in place) for the servo's lag and rounding, estimated from the measurements.

    To first order a servo follows x(t) with x − τ v + β a.
    """
    deviation = np.clip(measured - position, -OUTLIER * noise, OUTLIER * noise)
    plan = np.stack([v, a], axis=1)
    coefficients = np.linalg.lstsq(plan, deviation, rcond=None)[0]
    correction = plan @ coefficients
    if float(correction @ correction) < LAG_CHI2 * noise**2:
        return
    position += correction
    for piece in _pieces(t):
        if piece.stop - piece.start < LEAST_SAMPLES:
            continue
        v[piece] += coefficients[0] * a[piece] + coefficients[1] * np.gradient(a[piece], t[piece])
        a[piece] = np.gradient(v[piece], t[piece])


def _pieces(t: FloatArray) -> list[slice]:
    dt = np.diff(t)
    cuts = [0, *(np.flatnonzero(dt > GAP * np.median(dt)) + 1).tolist(), len(t)]
    return [slice(begin, end) for begin, end in itertools.pairwise(cuts)]


def _uniform_spline(t: FloatArray, values: FloatArray) -> BSpline:
    """Least-squares cubic spline through the values, with uniform cells of about `DEVIATION_CELL_S`."""
    cells = max(round((t[-1] - t[0]) / DEVIATION_CELL_S), 1)
    knots = np.linspace(t[0], t[-1], cells + 1)
    return make_lsq_spline(t, values, np.concatenate([[t[0]] * 3, knots, [t[-1]] * 3]))


def _deviates(t: FloatArray, deviation: FloatArray, noise: float) -> bool:
    """Whether means over `WINDOW_S` deviate from the plan by more than noise: the arm lags or is pushed."""
    window = np.floor((t - t[0]) / WINDOW_S).astype(int)
    count = np.bincount(window)
    means = np.bincount(window, deviation)[count > 0] / count[count > 0]
    mean_square = float(np.mean((means / noise) ** 2 * count[count > 0]))
    return len(t) >= LEAST_SAMPLES and len(means) > 1 and mean_square > 1 + DEVIATION_SD * math.sqrt(2 / len(means))
