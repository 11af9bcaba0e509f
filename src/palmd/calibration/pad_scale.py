"""Both pads' zero, scale and sign from a machined cylinder between the palms. Pure.

The cylinder touches each pad at s = R/tan(φ2/2), or at the corresponding place of palms with known curvature
(`calibration.cylinder`), and a pad reads counts = sign · counts_per_mm · (s − zero_mm): a straight line of counts over
s, fitted by least squares. Opening and closing have equal weights, so that a lag of the pad causes no shift.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from palmd.calibration.cylinder import (
    MIN_TRAVEL_M,
    SLOW_RAD_S,
    CylinderError,
    CylinderReadings,
    contacts_m,
    inliers,
    readings,
)
from palmd.config.pads import PadConfig
from palmd.events import Event, FloatArray
from palmd.system.arcs import FLAT
from palmd.system.mechanism import PALMS

MIN_READINGS = 500
MIN_EXPLAINED = 0.9
"""Share of the counts' variance that the line must explain, or they do not follow the cylinder."""
PLACES = 13
"""Number of values of a curve, from the hinge to the pad's end."""

_MAX_RATE_RAD_S = 1.05 * SLOW_RAD_S  # faster readings are from the approach to the plan's first pose
_STRETCHES = 10
_SMOOTHNESS = 3.0  # weight of the curve's second differences, in readings
_MIN_IN_STRETCH = 30


@dataclass(frozen=True, slots=True)
class PadScaleResult:
    """One pad: s = zero_mm + sign · counts/counts_per_mm, with 1σ of both, for an exact radius.

    noise_mm: 1σ of a reading about the line, rounding included. bend_mm: the largest mean deviation from the line over
    a tenth of the range, with its own sd; neither line nor curve explain it. low_mm, high_mm: the range. curve_mm: s
    minus the line's value, at evenly spaced places of the pad, if requested.
    """

    sign: int
    zero_mm: float
    zero_sd_mm: float
    counts_per_mm: float
    counts_per_mm_sd: float
    noise_mm: float
    bend_mm: float
    bend_sd_mm: float
    low_mm: float
    high_mm: float
    readings: int
    spoilt: int
    curve_mm: tuple[float, ...] = ()


def pad_scales(
    events: Iterable[Event],
    configs: Sequence[PadConfig],
    radius_m: float,
    curvatures: Sequence[float] = FLAT,
    *,
    curved: bool = False,
) -> tuple[PadScaleResult, PadScaleResult]:
    """Both pads; `configs` and `curvatures` (1/m) are those the daemon ran with; `curved`: fit the pads' curves too.

    Raises CylinderError if the readings do not suffice.
    """
    one, two = (
        _scale(number, found, config.length_mm if curved else None, radius_m, curvatures)
        for number, config, found in zip(PALMS, configs, readings(events, configs), strict=True)
    )
    return one, two


def is_slow(found: CylinderReadings) -> npt.NDArray[np.bool_]:
    """Which readings belong to the plan, and not to the approach to its first pose."""
    return np.asarray(found.rate <= _MAX_RATE_RAD_S)


def slow_readings(number: int, found: CylinderReadings) -> tuple[FloatArray, FloatArray]:
    """Opening (rad) and counts of a pad's readings while the palms moved slowly; CylinderError if there are too few."""
    selected = is_slow(found)
    counts = found.counts[selected]
    if len(counts) < MIN_READINGS:
        raise CylinderError(
            f"pad {number}: {len(counts)} readings while both pads were touched, at least {MIN_READINGS} are needed:"
            " does the cylinder lie on both palms all the time?"
        )
    return found.opening[selected], counts


def _scale(
    number: int, found: CylinderReadings, length_mm: float | None, radius_m: float, curvatures: Sequence[float]
) -> PadScaleResult:
    """With a `length_mm` a new curve over it is fitted; otherwise the configured curve has been applied."""
    opening, counts = slow_readings(number, found if length_mm is None else replace(found, counts=found.raw))
    s = contacts_m(radius_m, opening, curvatures)[number - 1] * 1e3
    if np.ptp(s) < 0.8 * MIN_TRAVEL_M * 1e3:
        raise CylinderError(f"the palms moved the cylinder by {np.ptp(s):.1f} mm only: was the plan stopped?")
    residuals = counts - _line(s, counts)
    kept = inliers(residuals, min_scale=1.0)
    spoilt, s, counts = int(np.sum(~kept)), s[kept], counts[kept]
    residuals = counts - _line(s, counts)
    if not residuals.var() < (1.0 - MIN_EXPLAINED) * counts.var():
        raise CylinderError(
            f"pad {number}'s counts do not follow the cylinder (from {counts.min():.0f} to {counts.max():.0f} over"
            f" {np.ptp(s):.0f} mm of travel): check pads.palm{number}.axis, and that nothing else lies on the pad"
        )
    return _result(s, counts, residuals, spoilt, length_mm)


def _line(s: FloatArray, counts: FloatArray) -> FloatArray:
    return np.asarray(np.polynomial.Polynomial.fit(s, counts, 1)(s))


def _result(
    s: FloatArray, counts: FloatArray, residuals: FloatArray, spoilt: int, length_mm: float | None
) -> PadScaleResult:
    """The line counts = mean + slope·(s − mean s), whose two parameters have independent errors."""
    n = len(s)
    deviations = s - s.mean()
    slope = float(deviations @ counts / (deviations @ deviations))
    curve: FloatArray = np.zeros(0)
    if length_mm is not None:  # s = value of the line + value of the curve
        excess = residuals / slope
        curve, explained = _curve(s + excess, -excess, length_mm)
        residuals = residuals + explained * slope
    noise = math.sqrt(float(residuals @ residuals) / (n - 2))
    slope_sd, mean_sd = noise / math.sqrt(float(deviations @ deviations)), noise / math.sqrt(n)
    zero = float(s.mean() - counts.mean() / slope)
    bend, bend_sd = _bend(s, residuals)
    scale = abs(slope)
    return PadScaleResult(
        sign=1 if slope > 0.0 else -1,
        zero_mm=zero,
        zero_sd_mm=math.hypot(mean_sd / scale, float(counts.mean()) * slope_sd / scale**2),
        counts_per_mm=scale,
        counts_per_mm_sd=slope_sd,
        noise_mm=noise / scale,
        bend_mm=bend / scale,
        bend_sd_mm=bend_sd / scale,
        low_mm=float(s.min()),
        high_mm=float(s.max()),
        readings=n,
        spoilt=spoilt,
        curve_mm=tuple(np.round(curve, 4).tolist()),
    )


def _curve(position_mm: FloatArray, excess: FloatArray, length_mm: float) -> tuple[FloatArray, FloatArray]:
    """The curve's values at `PLACES` even places that explain `excess` at `position_mm` (mm), and the explained part.

    Where there are no readings the curve continues as straight as possible.
    """
    grid_position = np.clip(position_mm / length_mm, 0.0, 1.0) * (PLACES - 1)
    lower = np.minimum(grid_position.astype(np.int64), PLACES - 2)
    rows = np.zeros((len(grid_position), PLACES))
    rows_index = np.arange(len(grid_position))
    rows[rows_index, lower], rows[rows_index, lower + 1] = 1.0 - (grid_position - lower), grid_position - lower
    bends = np.diff(np.eye(PLACES), 2, axis=0)
    values = np.asarray(
        np.linalg.solve(rows.T @ rows + _SMOOTHNESS * bends.T @ bends, rows.T @ excess), dtype=np.float64
    )
    return values, np.asarray(rows @ values)


def _bend(s: FloatArray, residuals: FloatArray) -> tuple[float, float]:
    """The largest mean residual over a tenth of the range, and its sd (counts)."""
    stretch = np.minimum(((s - s.min()) / np.ptp(s) * _STRETCHES).astype(np.int64), _STRETCHES - 1)
    means = [
        (float(abs(members.mean())), float(members.std()) / math.sqrt(len(members)))
        for members in (residuals[stretch == number] for number in range(_STRETCHES))
        if len(members) >= _MIN_IN_STRETCH
    ]
    return max(means, default=(0.0, 0.0))
