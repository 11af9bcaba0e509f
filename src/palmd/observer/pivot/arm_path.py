"""Where the arm had the pivot: measured positions smoothed by the velocities of the plan. Pure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, CubicHermiteSpline, PPoly, make_lsq_spline, make_smoothing_spline

from palmd.events import FloatArray

WINDOW_S = 0.5  # over which the arm may stray from its plan
STRAY_S = 1.0  # cells of the spline that it then strays by: finer ones would follow the noise
STRAYED = 3.0  # of the windows' mean squares, in sigmas of what noise gives
LEAST_SAMPLES = 8
TOLD = 25.0  # squared sigmas, from which measurements tell how the arm follows its plan
OUTLIER = 4.0
GAP = 4.0  # of the usual time between samples


@dataclass(frozen=True, slots=True)
class AxisPath:
    """Position, velocity and acceleration along one axis as functions of time, and the position's one-sigma (m)."""

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
    """The path through positions `measured` (m) with this `noise`; rates and accelerations: the plan's, where it tells.

    t: strictly increasing (s), of `LEAST_SAMPLES` samples at least.
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
    for piece in _pieces(t):  # over a gap nobody has told the velocity
        off = measured[piece] - planned[piece]
        middle = float(np.median(off))
        off = np.clip(off, middle - OUTLIER * noise, middle + OUTLIER * noise)
        if _strays(t[piece], off - off.mean(), noise):
            astray = _evenly(t[piece], measured[piece] - planned[piece])
            position[piece] = planned[piece] + astray(t[piece])
            v[piece] += astray(t[piece], 1)
            a[piece] += astray(t[piece], 2)
            sd = max(sd, noise / math.sqrt(STRAY_S / float(np.median(dt))))
        else:
            position[piece] = planned[piece] + off.mean()
    _follow(t, measured, position, v, a, noise)
    velocity = CubicHermiteSpline(t, v, a)
    return AxisPath(CubicHermiteSpline(t, position, v), velocity, velocity.derivative(), sd)


def _follow(
    t: FloatArray, measured: FloatArray, position: FloatArray, v: FloatArray, a: FloatArray, noise: float
) -> None:
    """Let the plan (in place) be followed as servos do: later, and its corners rounded, by how much measurements tell.

    To first order what a servo makes of x(t) is x − τ v + β a.
    """
    off = np.clip(measured - position, -OUTLIER * noise, OUTLIER * noise)
    plan = np.stack([v, a], axis=1)
    share = np.linalg.lstsq(plan, off, rcond=None)[0]
    moved = plan @ share
    if float(moved @ moved) < TOLD * noise**2:
        return
    position += moved
    for piece in _pieces(t):
        if piece.stop - piece.start < LEAST_SAMPLES:
            continue
        v[piece] += share[0] * a[piece] + share[1] * np.gradient(a[piece], t[piece])
        a[piece] = np.gradient(v[piece], t[piece])


def _pieces(t: FloatArray) -> list[slice]:
    dt = np.diff(t)
    cuts = [0, *(np.flatnonzero(dt > GAP * np.median(dt)) + 1).tolist(), len(t)]
    return [slice(begin, end) for begin, end in itertools.pairwise(cuts)]


def _evenly(t: FloatArray, values: FloatArray) -> BSpline:
    """The cubic spline of even cells of `STRAY_S` that comes nearest to the values."""
    cells = max(round((t[-1] - t[0]) / STRAY_S), 1)
    knots = np.linspace(t[0], t[-1], cells + 1)
    return make_lsq_spline(t, values, np.concatenate([[t[0]] * 3, knots, [t[-1]] * 3]))


def _strays(t: FloatArray, off: FloatArray, noise: float) -> bool:
    """Whether positions go by the plan no better than their means over `WINDOW_S` show: the arm lags or is pushed."""
    window = np.floor((t - t[0]) / WINDOW_S).astype(int)
    count = np.bincount(window)
    means = np.bincount(window, off)[count > 0] / count[count > 0]
    strayed = float(np.mean((means / noise) ** 2 * count[count > 0]))
    return len(t) >= LEAST_SAMPLES and len(means) > 1 and strayed > 1 + STRAYED * math.sqrt(2 / len(means))
