"""Characterises a pad from the reports of a marble that is rolled over it: figure 3.12 of the paper in numbers. Pure.

Reports are grouped into strokes, one per touch, ended by a packet with A = 0 or by silence. Intervals are taken within
strokes only, so that lifting the marble does no harm. Counts outside the pad are left out and counted.

Noise is what a smooth motion does not explain. Each stroke is divided into windows of WINDOW reports; in each one a
cubic in time is fitted to the counts by least squares, which allows for irregular intervals as it uses the times
themselves. Its residual sum of squares over WINDOW − 4 degrees of freedom is an unbiased estimate of the variance. A
corrupted report affects one window only: windows beyond OUTLIER_LIMIT times the median are left out, and the mean of
the others is taken, its sd from their scatter. Rounding to steps of q counts adds q²/12, evenly distributed while the
marble moves, and is subtracted; windows in which the fitted path stays within MIN_TRAVEL_STEPS steps are left out,
because there rounding is not noise. An error of a time stamp counts as noise too, in proportion to the marble's speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palmd.config.pads import PadConfig
from palmd.devices.pad import MARGIN_MM, PadReport, TouchTracker, counts_to_mm
from palmd.events import FloatArray

WINDOW = 10
DEGREES_OF_FREEDOM = WINDOW - 4
OUTLIER_LIMIT = 4.2
"""Times the median; 0.1 % of χ² with six degrees of freedom lie beyond, and the mean of the rest is 0.3 % low."""
MIN_TRAVEL_STEPS = 2.0
MIN_WINDOWS = 8
MIN_REPORTS = 150
BANDS = 3

_COARSEST_COUNTS = 16
_ON_STEPS_SHARE = 0.98  # of the reports; the others may be corrupted
_EXTREMES = (0.002, 0.998)  # quantiles of the reports, for the same reason

Axis = Literal["x", "y"]
AXES: tuple[Axis, Axis] = ("x", "y")


class TooFewReportsError(ValueError):
    """There are not enough reports; the text states what is missing and what to do."""


@dataclass(frozen=True, slots=True)
class Stroke:
    """The reports of one touch: arrival of the first byte (s), counts of both axes and of the pressure."""

    t: FloatArray
    x: FloatArray
    y: FloatArray
    pressure: FloatArray

    def counts(self, axis: Axis) -> FloatArray:
        """The counts of one axis."""
        return self.x if axis == "x" else self.y


@dataclass(frozen=True, slots=True)
class Band:
    """The intervals nearest to this many packet times; `share` is their share of all intervals (0 to 1)."""

    packet_times: int
    share: float
    mean_ms: float
    sd_ms: float


@dataclass(frozen=True, slots=True)
class AxisCharacteristic:
    """One axis: the step between positions, 1σ of noise with its own sd, and the reported range.

    `step_counts` is the effective quantisation. The range is that of the distance from the hinge for the configured
    axis, and relative to the pad's own zero for the other.
    """

    step_counts: int
    step_mm: float
    noise_mm: float
    noise_sd_mm: float
    low_mm: float
    high_mm: float


@dataclass(frozen=True, slots=True)
class PadCharacteristic:
    """All results. The dead band is the smallest reported pressure: the true one is no larger.

    `out_of_range` counts reports outside the pad, which are not used elsewhere. The last fields describe the wire:
    bytes, discarded bytes by cause, and reads with several packets, whose times are back-dated.
    """

    reports: int
    touches: int
    seconds: float
    interval_mean_ms: float
    interval_sd_ms: float
    packet_time_ms: float
    bands: tuple[Band, ...]
    x: AxisCharacteristic
    y: AxisCharacteristic
    dead_band_counts: int
    dead_band_n: float
    pressure_high: int
    pressure_levels: int
    out_of_range: int
    received_bytes: int
    bad_header_bytes: int
    bad_data_bytes: int
    truncated_bytes: int
    batches: int

    def along(self, config: PadConfig) -> AxisCharacteristic:
        """The axis along which the configuration measures the distance from the hinge."""
        return self.x if config.axis == "x" else self.y


def characterise(packets: Sequence[PadReport], counts: Mapping[str, int], config: PadConfig) -> PadCharacteristic:
    """Characterise a pad from its reports in order of arrival, and the counters of its driver.

    Raises TooFewReportsError for fewer than MIN_REPORTS reports, or for too little motion along an axis.
    """
    touches = strokes(packets, config)
    reports = sum(len(stroke.t) for stroke in touches)
    if reports < MIN_REPORTS:
        outside = sum(packet.in_use for packet in packets) - reports
        raise TooFewReportsError(
            f"{outside} reports are outside the pad: check axis, sign, zero_mm and counts_per_mm"
            if outside > reports
            else f"too few reports ({reports} of at least {MIN_REPORTS}): roll the marble for longer"
        )
    intervals = intervals_s(touches)
    pressure = np.concatenate([stroke.pressure for stroke in touches])
    dead_band = int(np.partition(pressure, 1)[1])  # the second smallest, as a single one may be corrupted
    x, y = (_axis_characteristic(touches, axis, config) for axis in AXES)
    return PadCharacteristic(
        reports=reports,
        touches=len(touches),
        seconds=float(touches[-1].t[-1] - touches[0].t[0]),
        interval_mean_ms=float(intervals.mean()) * 1e3,
        interval_sd_ms=float(intervals.std()) * 1e3,
        packet_time_ms=packet_time_s(intervals, config) * 1e3,
        bands=_bands(intervals, packet_time_s(intervals, config)),
        x=x,
        y=y,
        dead_band_counts=dead_band,
        dead_band_n=dead_band * config.newtons_per_count,
        pressure_high=int(pressure.max()),
        pressure_levels=len(np.unique(pressure)),
        out_of_range=sum(packet.in_use for packet in packets) - reports,
        received_bytes=counts.get("bytes", 0),
        bad_header_bytes=counts.get("bad_header", 0),
        bad_data_bytes=counts.get("bad_data", 0),
        truncated_bytes=counts.get("truncated", 0),
        batches=counts.get("batches", 0),
    )


def strokes(packets: Sequence[PadReport], config: PadConfig) -> list[Stroke]:
    """The reports of each touch; a touch ends by A = 0 or by silence, as in the daemon."""
    tracker = TouchTracker(1, config.report_s)
    touches: list[list[PadReport]] = []
    for packet in packets:
        tracker.poll(packet.t_first)
        is_start = not tracker.touching
        tracker.report(packet)
        if not packet.in_use:
            continue
        if is_start:
            touches.append([])
        touches[-1].append(packet)
    strokes_on_pad = [_on_pad(_stroke(touch), config) for touch in touches]
    return [stroke for stroke in strokes_on_pad if len(stroke.t)]


def intervals_s(touches: Sequence[Stroke]) -> FloatArray:
    """The times between consecutive reports of the same touch (s)."""
    return np.concatenate([np.diff(stroke.t) for stroke in touches])


def packet_time_s(gaps: FloatArray, config: PadConfig) -> float:
    """The unit of the bands (s): the pad's shortest regular interval, or one packet time on the line if longer."""
    return max(float(np.quantile(gaps, 0.1)), config.report_s)


def position_mm(counts: FloatArray, axis: Axis, config: PadConfig) -> FloatArray:
    """Distance from the hinge for the configured axis, else from the pad's own zero (mm)."""
    if axis == config.axis:
        return np.array([counts_to_mm(config, each) for each in counts.tolist()])
    return counts / config.counts_per_mm


def residuals(touches: Sequence[Stroke], axis: Axis, step_counts: int) -> FloatArray:
    """Residuals of local cubic fits of the counts: a row of WINDOW for each window in which the marble moved."""
    cut = [_windows(stroke.t, stroke.counts(axis)) for stroke in touches]
    t, counts = (np.concatenate(each) for each in zip(*cut, strict=True))
    first, last = t[:, :1], t[:, -1:]
    u = (2.0 * t - first - last) / np.maximum(last - first, 1e-9)
    basis = np.linalg.qr(u[:, :, None] ** np.arange(4)).Q
    fitted = np.einsum("kip,kjp,kj->ki", basis, basis, counts)
    moved = np.ptp(fitted, axis=1) >= MIN_TRAVEL_STEPS * step_counts
    return np.asarray((counts - fitted)[moved])


def _axis_characteristic(touches: Sequence[Stroke], axis: Axis, config: PadConfig) -> AxisCharacteristic:
    counts = np.concatenate([stroke.counts(axis) for stroke in touches])
    step = _step_counts(counts)
    fit_residuals = residuals(touches, axis, step)
    if len(fit_residuals) < MIN_WINDOWS:
        raise TooFewReportsError(
            f"the marble hardly moved along {axis}: roll it over the whole pad, and lift it less often"
        )
    noise, noise_sd = _noise(fit_residuals, step)
    ends = position_mm(np.quantile(counts, _EXTREMES, method="nearest"), axis, config)
    per_mm = config.counts_per_mm
    return AxisCharacteristic(
        step, step / per_mm, noise / per_mm, noise_sd / per_mm, float(min(ends)), float(max(ends))
    )


def _noise(fit_residuals: FloatArray, step: int) -> tuple[float, float]:
    """1σ of the noise and its own sd, in counts; zero where rounding explains everything."""
    variances = np.sum(fit_residuals**2, axis=1) / DEGREES_OF_FREEDOM
    inliers = variances[variances <= OUTLIER_LIMIT * np.median(variances)]
    variance_sd = float(inliers.std()) / math.sqrt(len(inliers))
    variance = max(float(inliers.mean()) - step**2 / 12, 0.0)
    noise = math.sqrt(variance)
    return noise, math.sqrt(variance + variance_sd) - noise  # also at zero this is the largest likely noise


def _step_counts(counts: FloatArray) -> int:
    """The largest step that nearly all counts are multiples of, from a common offset."""
    whole = counts.astype(np.int64)
    for step in range(_COARSEST_COUNTS, 1, -1):
        if np.bincount(whole % step).max() >= _ON_STEPS_SHARE * len(whole):
            return step
    return 1


def _bands(gaps: FloatArray, packet_s: float) -> tuple[Band, ...]:
    nearest = np.maximum(np.rint(gaps / packet_s), 1)
    found = []
    for times in range(1, BANDS + 1):
        members = gaps[nearest == times]
        if len(members):
            found.append(Band(times, len(members) / len(gaps), float(members.mean()) * 1e3, float(members.std()) * 1e3))
    return tuple(found)


def _windows(t: FloatArray, counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    whole = len(t) // WINDOW * WINDOW
    return t[:whole].reshape(-1, WINDOW), counts[:whole].reshape(-1, WINDOW)


def _stroke(touch: Sequence[PadReport]) -> Stroke:
    rows = [(packet.t_first, packet.x_counts, packet.y_counts, packet.pressure) for packet in touch]
    t, x, y, pressure = np.array(rows, dtype=np.float64).T
    return Stroke(t, x, y, pressure)


def _on_pad(stroke: Stroke, config: PadConfig) -> Stroke:
    """The stroke without reports that the daemon would reject as outside the pad."""
    s_mm = position_mm(stroke.counts(config.axis), config.axis, config)
    on = (s_mm > 0.0) & (s_mm <= config.length_mm + MARGIN_MM)
    return Stroke(stroke.t[on], stroke.x[on], stroke.y[on], stroke.pressure[on])
