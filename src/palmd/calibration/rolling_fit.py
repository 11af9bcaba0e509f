"""Gravity in the plane of the palms, from a ball or a cylinder that rolls down one palm after the other. Pure.

A roller of radius R and radius of gyration ρ on a plane that rises at the angle φ away from the hinge (φ1 of palm 1,
φ12 of palm 2) rolls towards the hinge with

    κ·s̈ = −g·(sin(φ + δ) − μ·|cos(φ + δ)|),   κ = 1 + ρ²/R²                                                 (1)

where κ is 7/5 for a ball and 3/2 for a solid cylinder, μ is the rolling resistance, which opposes the motion, and δ is
the angle by which the true palm angles exceed the daemon's: the error of the arm's yaw. Palm 1 slopes down to the hinge
for small φ1 and palm 2 for φ12 near 180°, where sin(φ + δ) decreases with δ: this distinguishes δ from g. The influence
of the resistance decreases with the slope: several slopes distinguish it from g.

Each roll is fitted by s(t) = s0 + v·t + a·t²/2 (2), for any initial push, and (1) to all values of a by least squares.
Outliers of both fits are left out and counted.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Literal

import numpy as np

from palmd.calibration.solving import solved
from palmd.events import Event, FloatArray, PadLift, PadSample, PalmSample
from palmd.system.mechanism import PALMS, directions

RollerKind = Literal["ball", "cylinder"]
INERTIA: Mapping[RollerKind, float] = MappingProxyType({"ball": 7.0 / 5.0, "cylinder": 3.0 / 2.0})
"""κ of (1)."""

MIN_READINGS = 8
MIN_ROLLS_PER_PALM = 4
MIN_TRAVEL = 0.012
"""m: a shorter motion on one pad is not a roll."""
MIN_SLOPE_RANGE = math.radians(5.0)
"""Smallest difference of slopes on one of the palms, for the resistance to be determined."""

_REVERSAL = 1e-3  # m: an uphill motion by this much begins another roll
_AT_TOP, _AT_BOTTOM = 6e-4, 1.5e-3  # m: so near to the ends it may be in the hand, or on both palms
_RELEASED = 3e-4  # m: below its rest by this much, the roller has been released
_SILENCE = 0.06  # s: a touch has ended
_OUTLIER_LIMIT = 3.5  # standard deviations, for readings of a roll
_MAX_RMS = 5e-4  # m: of the residuals of (2) for a roll; a hand that guides the roller leaves more
_ROLL_OUTLIER_LIMIT = 4.0  # standard deviations, for rolls
_ROUNDS = 20

TOO_SHORT, NOT_SMOOTH, INCONSISTENT = "too short", "not smooth", "inconsistent with the others"
"""Reasons for leaving out a roll."""


class TooFewRollsError(ValueError):
    """There are not enough usable rolls; the text states what is missing and what to do."""


@dataclass(frozen=True, slots=True)
class Roll:
    """The readings of one roll: the pad, its palm's angle phi (rad: φ1 or φ12), times (s) and distances (m).

    They begin before the release, when the roller lay at `rest` (m).
    """

    pad: int
    phi: float
    rest: float
    t: FloatArray
    s: FloatArray


@dataclass(frozen=True, slots=True)
class Acceleration:
    """Fit of (2) to a roll: the acceleration (m/s²) with its 1σ, and the RMS of the residuals (m)."""

    pad: int
    phi: float
    a: float
    a_sd: float
    rms: float
    readings: int
    left_out: int


@dataclass(frozen=True, slots=True)
class GravityFit:
    """g (m/s²), δ (rad) and μ with their 1σ; scatter is that of the rolls over the expected one.

    `used` are the rolls of the fit, `inconsistent` the number of outliers.
    """

    g: float
    delta: float
    resistance: float
    g_sd: float
    delta_sd: float
    resistance_sd: float
    scatter: float
    used: tuple[Acceleration, ...]
    inconsistent: int

    def acceleration(self, phi: float, kind: RollerKind) -> float:
        """Acceleration by (1) for a palm at phi (rad), m/s²."""
        return float(_model(np.array([phi]), INERTIA[kind], np.array([self.g, self.delta, self.resistance]))[0])


def find_rolls(events: Sequence[Event]) -> tuple[list[Roll], int]:
    """The rolls towards the hinge among the readings of palms at rest, and the number of those that were too short.

    A roll is a descent that one pad reports while the other is silent. Its ends are left out: at the top the hand
    releases the roller, at the bottom the roller meets the other palm. Without a PalmSample there are no rolls.
    """
    angles = [directions(event.angles) for event in events if isinstance(event, PalmSample)]
    if not angles:
        return [], 0
    phi = np.mean(np.array(angles), axis=0)
    rolls: list[Roll] = []
    short = 0
    for pad in PALMS:
        other = np.array([each.t_sample for each in events if isinstance(each, PadSample) and each.pad != pad])
        for t, s in _touches(events, pad):
            for start, top, end in _descents(s):
                first = top + int(np.flatnonzero(s[top:end] > s[top] - _AT_TOP)[-1]) + 1
                bottom = first + int(np.argmax(s[first:end] < s[end - 1] + _AT_BOTTOM))
                last = min(bottom, first + int(np.searchsorted(t[first:end], _next(other, float(t[first])))))
                if last - first < MIN_READINGS or s[first] - s[last - 1] < MIN_TRAVEL:
                    short += 1
                    continue
                rest = float(np.median(s[start:first][s[start:first] > s[top] - _AT_TOP]))
                rolls.append(Roll(1 if pad == 1 else 2, float(phi[pad - 1]), rest, t[start:last], s[start:last]))
    return sorted(rolls, key=lambda roll: float(roll.t[0])), short


def accelerate(roll: Roll, noise: float) -> Acceleration | None:
    """Least-squares fit of (2) without outliers; None for a roll that is not smooth.

    noise: 1σ of a position (m), rounding included; a lower bound for the readings' scatter.
    """
    t = roll.t - float(roll.t[-1])
    basis = np.stack([np.ones_like(t), t, 0.5 * t * t], axis=1)
    # the first reading below the rest was selected for being low, which would bias the fit: it is left out as well
    rolling = np.arange(len(t)) > np.flatnonzero(roll.s > roll.rest - _RELEASED)[-1] + 1
    used = rolling
    for _ in range(_ROUNDS):
        if used.sum() < MIN_READINGS:
            return None
        fit = np.linalg.lstsq(basis[used], roll.s[used], rcond=None)[0]
        residuals = roll.s - basis @ fit
        spread = max(1.4826 * float(np.median(np.abs(residuals[used]))), noise)
        is_inlier = rolling & (np.abs(residuals) < _OUTLIER_LIMIT * spread)
        if (is_inlier == used).all():
            break
        used = is_inlier
    count, left_out = int(used.sum()), int((rolling & ~used).sum())
    rms = math.sqrt(float(residuals[used] @ residuals[used]) / (count - 3))
    if rms > _MAX_RMS or left_out > count or fit[2] >= 0.0:
        return None
    variance = np.linalg.inv(basis[used].T @ basis[used])[2, 2]
    a_sd = max(rms, noise) * math.sqrt(float(variance))
    return Acceleration(roll.pad, roll.phi, float(fit[2]), a_sd, rms, count, left_out)


def fit_gravity(rolls: Sequence[Acceleration], kind: RollerKind) -> GravityFit:
    """Weighted least-squares fit of (1) to the rolls without outliers.

    Raises TooFewRollsError unless both palms have enough rolls, on sufficiently different slopes.
    """
    _require_enough_rolls(rolls)
    phi, a, sd = (np.array([getattr(roll, name) for roll in rolls]) for name in ("phi", "a", "a_sd"))
    selected = np.ones(len(rolls), dtype=bool)
    x = np.array([9.81, 0.0, 0.0])
    for _ in range(_ROUNDS):
        fit = solved(partial(_misfits, phi[selected], a[selected], sd[selected], INERTIA[kind]), x)
        x, residuals = fit.x, _misfits(phi, a, sd, INERTIA[kind], fit.x)
        spread = max(1.4826 * float(np.median(np.abs(residuals[selected]))), 1.0)
        is_inlier = np.abs(residuals) < _ROLL_OUTLIER_LIMIT * spread
        if (is_inlier == selected).all():
            break
        selected = is_inlier
    used = tuple(roll for roll, keep in zip(rolls, selected, strict=True) if keep)
    _require_enough_rolls(used)
    scatter = math.sqrt(float(residuals[selected] @ residuals[selected]) / (len(used) - 3))
    sds = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac))) * max(scatter, 1.0)
    (g, delta, resistance), (g_sd, delta_sd, resistance_sd) = map(float, x), map(float, sds)
    return GravityFit(
        g, delta, resistance, g_sd, delta_sd, resistance_sd, scatter, used, inconsistent=len(rolls) - len(used)
    )


def slope(pad: int, phi: float) -> float:
    """Slope of a palm towards the hinge (rad), by the daemon's angles."""
    return phi if pad == 1 else math.pi - phi


def causes(too_short: int, not_smooth: int, inconsistent: int) -> Counter[str]:
    """Number of rolls that were left out, by reason; reasons without rolls are omitted."""
    return +Counter({TOO_SHORT: too_short, NOT_SMOOTH: not_smooth, INCONSISTENT: inconsistent})


def _require_enough_rolls(rolls: Sequence[Acceleration]) -> None:
    slope_range = 0.0
    for pad in PALMS:
        slopes = [slope(pad, roll.phi) for roll in rolls if roll.pad == pad]
        if len(slopes) < MIN_ROLLS_PER_PALM:
            raise TooFewRollsError(
                f"{len(slopes)} of at least {MIN_ROLLS_PER_PALM} good rolls on palm {pad}: place the roller at its"
                " upper end, let go without a push, and let it roll to the hinge"
            )
        slope_range = max(slope_range, max(slopes) - min(slopes))
    if slope_range < MIN_SLOPE_RANGE:
        raise TooFewRollsError(
            f"the slopes on each palm differ by at most {math.degrees(slope_range):.1f}°, which cannot distinguish"
            " rolling resistance from gravity: widen the limits of the palms' angles"
        )


def _touches(events: Sequence[Event], pad: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Times and distances of each touch of a pad; a touch ends with a PadLift or silence."""
    touch: list[tuple[float, float]] = []
    for event in events:
        if not isinstance(event, PadSample | PadLift) or event.pad != pad:
            continue
        if touch and (isinstance(event, PadLift) or event.t_sample - touch[-1][0] > _SILENCE):
            yield _arrays(touch)
            touch = []
        if isinstance(event, PadSample):
            touch.append((event.t_sample, event.s))
    if touch:
        yield _arrays(touch)


def _arrays(touch: Sequence[tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
    t, s = np.array(touch, dtype=np.float64).T
    return t, s


def _descents(s: FloatArray) -> Iterator[tuple[int, int, int]]:
    """Descents from a maximum to a minimum without a rise by `_REVERSAL`, of more than that height.

    For each its beginning (the ascent to the maximum), the maximum, and its end.
    """
    start = high = low = 0
    for i in range(len(s)):
        if s[i] < s[low]:
            low = i
        elif s[i] > s[low] + _REVERSAL or (s[i] >= s[high] and s[high] - s[low] < _REVERSAL):
            if s[high] - s[low] > _REVERSAL:
                yield start, high, low + 1
                start = low + 1
            high = low = i
    if len(s) and s[high] - s[low] > _REVERSAL:
        yield start, high, low + 1


def _next(times: FloatArray, t: float) -> float:
    later = times[times >= t]
    return float(later[0]) if len(later) else math.inf


def _model(phi: FloatArray, inertia: float, x: FloatArray) -> FloatArray:
    """Accelerations by (1) for x = (g, δ, μ)."""
    g, delta, mu = x
    return np.asarray(-g / inertia * (np.sin(phi + delta) - mu * np.abs(np.cos(phi + delta))))


def _misfits(phi: FloatArray, a: FloatArray, sd: FloatArray, inertia: float, x: FloatArray) -> FloatArray:
    return np.asarray((a - _model(phi, inertia, x)) / sd)
