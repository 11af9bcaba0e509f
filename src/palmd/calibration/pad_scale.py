"""Both pads' zero, scale and sign from a turned cylinder between the palms. Pure.

The cylinder touches each pad at s = R/tan(φ2/2), or where it does on arcs of known curvature (`calibration.cylinder`),
and a pad says counts = sign · counts_per_mm · (s − zero_mm): a straight line through counts over s, fitted by least
squares. Opening and closing weigh the same, so that a pad that speaks later than the arm shifts nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from palmd.calibration.cylinder import (
    LEAST_TRAVEL_M,
    SLOW_RAD_S,
    CylinderError,
    CylinderReadings,
    contacts_m,
    not_spoilt,
    readings,
)
from palmd.config.pads import PadConfig
from palmd.events import Event, FloatArray
from palmd.system.arcs import FLAT
from palmd.system.mechanism import PALMS

LEAST_READINGS = 500
LEAST_FOLLOWED = 0.9
"""Of the counts' scatter that the line must explain, or they do not follow the cylinder."""
PLACES = 13
"""Of a curve, from the hinge to the pad's end."""

_SLOW_ENOUGH = 1.05 * SLOW_RAD_S  # faster ones are from the way to the plan's beginning
_STRETCHES = 10
_STIFF = 3.0  # readings' worth, of each place's bend
_LEAST_IN_STRETCH = 30


@dataclass(frozen=True, slots=True)
class PadScale:
    """One pad: s = zero_mm + sign · counts/counts_per_mm, with one sigma of both, the radius taken for exact.

    noise_mm: one sigma of a reading about the line, rounding included. bend_mm: the largest mean deviation from the
    line over a tenth of the way, with its own sd; it is what a straight line, and the curve, cannot explain. low_mm,
    high_mm: the way. curve_mm: by how much s is more than on the line, at so many even places of the pad, where asked.
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
) -> tuple[PadScale, PadScale]:
    """Both pads; `configs` are those the daemon ran with, `curvatures` the palms' (1/m); `curved`: their curves too.

    Raises CylinderError for readings that do not suffice.
    """
    one, two = (
        _scale(number, found, config.length_mm if curved else None, radius_m, curvatures)
        for number, config, found in zip(PALMS, configs, readings(events, configs), strict=True)
    )
    return one, two


def slow_enough(found: CylinderReadings) -> npt.NDArray[np.bool_]:
    """Which readings are of the plan, and not of the way to its beginning."""
    return np.asarray(found.rate <= _SLOW_ENOUGH)


def slow_readings(number: int, found: CylinderReadings) -> tuple[FloatArray, FloatArray]:
    """Opening (rad) and counts of a pad's readings while the palms moved slowly; CylinderError for too few."""
    slow = slow_enough(found)
    counts = found.counts[slow]
    if len(counts) < LEAST_READINGS:
        raise CylinderError(
            f"pad {number}: {len(counts)} readings while both pads were touched, of at least {LEAST_READINGS}:"
            " does the cylinder lie on both palms all the time?"
        )
    return found.opening[slow], counts


def _scale(
    number: int, found: CylinderReadings, length_mm: float | None, radius_m: float, curvatures: Sequence[float]
) -> PadScale:
    """With a `length_mm` a curve over it is found anew; without, the configured one has been allowed for."""
    opening, counts = slow_readings(number, found if length_mm is None else replace(found, counts=found.raw))
    s = contacts_m(radius_m, opening, curvatures)[number - 1] * 1e3
    if np.ptp(s) < 0.8 * LEAST_TRAVEL_M * 1e3:
        raise CylinderError(f"the palms moved the cylinder by {np.ptp(s):.1f} mm only: was the plan stopped?")
    left = counts - _line(s, counts)
    kept = not_spoilt(left, least=1.0)
    spoilt, s, counts = int(np.sum(~kept)), s[kept], counts[kept]
    left = counts - _line(s, counts)
    if not left.var() < (1.0 - LEAST_FOLLOWED) * counts.var():
        raise CylinderError(
            f"pad {number}'s counts do not follow the cylinder (from {counts.min():.0f} to {counts.max():.0f} over"
            f" {np.ptp(s):.0f} mm of way): check pads.palm{number}.axis, and that nothing else lies on the pad"
        )
    return _result(s, counts, left, spoilt, length_mm)


def _line(s: FloatArray, counts: FloatArray) -> FloatArray:
    return np.asarray(np.polynomial.Polynomial.fit(s, counts, 1)(s))


def _result(s: FloatArray, counts: FloatArray, left: FloatArray, spoilt: int, length_mm: float | None) -> PadScale:
    """The line counts = mean + slope·(s − mean s), whose two numbers err independently of each other."""
    n = len(s)
    away = s - s.mean()
    slope = float(away @ counts / (away @ away))
    curve: FloatArray = np.zeros(0)
    if length_mm is not None:  # beyond the line: s = what is on it + the curve there
        beyond = left / slope
        curve, explained = _curve(s + beyond, -beyond, length_mm)
        left = left + explained * slope
    noise = math.sqrt(float(left @ left) / (n - 2))
    slope_sd, mean_sd = noise / math.sqrt(float(away @ away)), noise / math.sqrt(n)
    zero = float(s.mean() - counts.mean() / slope)
    bend, bend_sd = _bend(s, left)
    scale = abs(slope)
    return PadScale(
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


def _curve(straight: FloatArray, more: FloatArray, length_mm: float) -> tuple[FloatArray, FloatArray]:
    """The values at `PLACES` even places of the pad that explain `more` at `straight` (mm), and what they explain.

    Where nothing was felt they go on as straight as can be.
    """
    at = np.clip(straight / length_mm, 0.0, 1.0) * (PLACES - 1)
    before = np.minimum(at.astype(np.int64), PLACES - 2)
    rows = np.zeros((len(at), PLACES))
    each = np.arange(len(at))
    rows[each, before], rows[each, before + 1] = 1.0 - (at - before), at - before
    bends = np.diff(np.eye(PLACES), 2, axis=0)
    values = np.asarray(np.linalg.solve(rows.T @ rows + _STIFF * bends.T @ bends, rows.T @ more), dtype=np.float64)
    return values, np.asarray(rows @ values)


def _bend(s: FloatArray, left: FloatArray) -> tuple[float, float]:
    """The largest mean that is left over a tenth of the way, and its sd (counts)."""
    stretch = np.minimum(((s - s.min()) / np.ptp(s) * _STRETCHES).astype(np.int64), _STRETCHES - 1)
    means = [
        (float(abs(some.mean())), float(some.std()) / math.sqrt(len(some)))
        for some in (left[stretch == number] for number in range(_STRETCHES))
        if len(some) >= _LEAST_IN_STRETCH
    ]
    return max(means, default=(0.0, 0.0))
