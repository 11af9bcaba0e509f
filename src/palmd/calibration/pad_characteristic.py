"""What a pad is worth, from the reports of a marble that is rolled over it: figure 3.12 of the paper in numbers. Pure.

Reports are grouped into strokes: one touch each, ended by a packet with A = 0 or by silence. Intervals are taken
within strokes only, so lifting the marble spoils nothing. Counts that cannot be a place on the pad are left out
and counted.

Noise is what a smooth motion does not explain. Each stroke is cut into windows of WINDOW reports; in each one a
cubic in time is fitted to the counts by least squares, which allows for irregular intervals as it uses the times
themselves. Its residual sum of squares over WINDOW − 4 degrees of freedom estimates the variance without bias. A
spoilt report spoils one window only: those beyond SPOILT times the median are left out, and the mean of the others
is taken, its sd from their scatter. Rounding to steps of q counts adds q²/12, evenly spread while the marble moves,
and is taken out; windows in which the fitted path stays within TRAVEL steps are left out, since there rounding is
no noise. A time stamp that is off counts as noise too, in proportion to the marble's speed.
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
SPOILT = 4.2
"""Of χ² with six degrees of freedom 0.1 % lie beyond so many medians; the mean of the rest is 0.3 % low."""
TRAVEL = 2.0
LEAST_WINDOWS = 8
LEAST_REPORTS = 150
BANDS = 3

_COARSEST_COUNTS = 16
_ON_THE_STEPS = 0.98  # of the reports; the others may be spoilt
_EXTREMES = (0.002, 0.998)  # of the reports, likewise

Axis = Literal["x", "y"]
AXES: tuple[Axis, Axis] = ("x", "y")


class TooFewReportsError(ValueError):
    """The reports do not suffice; the text says what is missing and what to do."""


@dataclass(frozen=True, slots=True)
class Stroke:
    """The reports of one touch: when the first byte arrived (s), counts of both axes and of the pressure."""

    t: FloatArray
    x: FloatArray
    y: FloatArray
    pressure: FloatArray

    def counts(self, axis: Axis) -> FloatArray:
        """The counts of one axis."""
        return self.x if axis == "x" else self.y


@dataclass(frozen=True, slots=True)
class Band:
    """The intervals nearest to so many packet times; `share` is that of all intervals (0 to 1)."""

    packet_times: int
    share: float
    mean_ms: float
    sd_ms: float


@dataclass(frozen=True, slots=True)
class AxisCharacteristic:
    """One axis: the step between positions, one sigma of noise with its own sd, and the range that was reported.

    `step_counts` is the effective quantisation. The range is that of the distance from the hinge along the
    configured axis, and counted from the pad's own zero on the other.
    """

    step_counts: int
    step_mm: float
    noise_mm: float
    noise_sd_mm: float
    low_mm: float
    high_mm: float


@dataclass(frozen=True, slots=True)
class PadCharacteristic:
    """All that is found. The dead band is the least pressure reported: the true one is no larger.

    `out_of_range` counts reports that cannot be a place on the pad; they are part of nothing else here. The last
    lines tell what came over the wire: bytes, those discarded by cause, and reads with several
    packets, whose times rest on back-dating.
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
        """The axis that the configuration measures the distance from the hinge along."""
        return self.x if config.axis == "x" else self.y


def characterise(packets: Sequence[PadReport], counts: Mapping[str, int], config: PadConfig) -> PadCharacteristic:
    """Everything about the pad; reports in the order of arrival, and what its driver has counted meanwhile.

    Raises TooFewReportsError for fewer than LEAST_REPORTS reports, or for too little motion along an axis.
    """
    touches = strokes(packets, config)
    reports = sum(len(stroke.t) for stroke in touches)
    if reports < LEAST_REPORTS:
        off = sum(packet.in_use for packet in packets) - reports
        raise TooFewReportsError(
            f"{off} reports are no place on the pad: check axis, sign, zero_mm and counts_per_mm"
            if off > reports
            else f"too few reports ({reports} of at least {LEAST_REPORTS}): roll the marble for longer"
        )
    gaps = intervals_s(touches)
    pressure = np.concatenate([stroke.pressure for stroke in touches])
    dead_band = int(np.partition(pressure, 1)[1])  # the second least, as a single one may be spoilt
    x, y = (_axis_characteristic(touches, axis, config) for axis in AXES)
    return PadCharacteristic(
        reports=reports,
        touches=len(touches),
        seconds=float(touches[-1].t[-1] - touches[0].t[0]),
        interval_mean_ms=float(gaps.mean()) * 1e3,
        interval_sd_ms=float(gaps.std()) * 1e3,
        packet_time_ms=packet_time_s(gaps, config) * 1e3,
        bands=_bands(gaps, packet_time_s(gaps, config)),
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
    """The reports of each touch; a touch ends as the daemon has it, by A = 0 or by silence."""
    tracker = TouchTracker(1, config.report_s)
    found: list[list[PadReport]] = []
    for packet in packets:
        tracker.poll(packet.t_first)
        begins = not tracker.touching
        tracker.report(packet)
        if not packet.in_use:
            continue
        if begins:
            found.append([])
        found[-1].append(packet)
    cut = [_on_pad(_stroke(touch), config) for touch in found]
    return [stroke for stroke in cut if len(stroke.t)]


def intervals_s(touches: Sequence[Stroke]) -> FloatArray:
    """The times between one report and the next of the same touch (s), in order."""
    return np.concatenate([np.diff(stroke.t) for stroke in touches])


def packet_time_s(gaps: FloatArray, config: PadConfig) -> float:
    """The unit of the bands (s): the pad's shortest regular interval, or one packet on the line if that is longer."""
    return max(float(np.quantile(gaps, 0.1)), config.report_s)


def position_mm(counts: FloatArray, axis: Axis, config: PadConfig) -> FloatArray:
    """The distance from the hinge along the configured axis, from the pad's own zero across it (mm)."""
    if axis == config.axis:
        return np.array([counts_to_mm(config, each) for each in counts.tolist()])
    return counts / config.counts_per_mm


def residuals(touches: Sequence[Stroke], axis: Axis, step_counts: int) -> FloatArray:
    """What a local cubic in time leaves of the counts: a row of WINDOW for each window in which the marble moved."""
    cut = [_windows(stroke.t, stroke.counts(axis)) for stroke in touches]
    t, counts = (np.concatenate(each) for each in zip(*cut, strict=True))
    first, last = t[:, :1], t[:, -1:]
    u = (2.0 * t - first - last) / np.maximum(last - first, 1e-9)
    basis = np.linalg.qr(u[:, :, None] ** np.arange(4)).Q
    fitted = np.einsum("kip,kjp,kj->ki", basis, basis, counts)
    moved = np.ptp(fitted, axis=1) >= TRAVEL * step_counts
    return np.asarray((counts - fitted)[moved])


def _axis_characteristic(touches: Sequence[Stroke], axis: Axis, config: PadConfig) -> AxisCharacteristic:
    counts = np.concatenate([stroke.counts(axis) for stroke in touches])
    step = _step_counts(counts)
    left = residuals(touches, axis, step)
    if len(left) < LEAST_WINDOWS:
        raise TooFewReportsError(
            f"the marble has hardly moved along {axis}: roll it over the whole pad, without lifting it all the time"
        )
    noise, noise_sd = _noise(left, step)
    ends = position_mm(np.quantile(counts, _EXTREMES, method="nearest"), axis, config)
    per_mm = config.counts_per_mm
    return AxisCharacteristic(
        step, step / per_mm, noise / per_mm, noise_sd / per_mm, float(min(ends)), float(max(ends))
    )


def _noise(left: FloatArray, step: int) -> tuple[float, float]:
    """One sigma of the noise and its own sd, in counts; zero where rounding explains everything."""
    each = np.sum(left**2, axis=1) / DEGREES_OF_FREEDOM
    kept = each[each <= SPOILT * np.median(each)]
    whole_sd = float(kept.std()) / math.sqrt(len(kept))
    variance = max(float(kept.mean()) - step**2 / 12, 0.0)
    noise = math.sqrt(variance)
    return noise, math.sqrt(variance + whole_sd) - noise  # at zero, too, it says how large the noise may be


def _step_counts(counts: FloatArray) -> int:
    """The largest step that nearly all counts are multiples of, from a common offset."""
    whole = counts.astype(np.int64)
    for step in range(_COARSEST_COUNTS, 1, -1):
        if np.bincount(whole % step).max() >= _ON_THE_STEPS * len(whole):
            return step
    return 1


def _bands(gaps: FloatArray, packet_s: float) -> tuple[Band, ...]:
    nearest = np.maximum(np.rint(gaps / packet_s), 1)
    found = []
    for times in range(1, BANDS + 1):
        some = gaps[nearest == times]
        if len(some):
            found.append(Band(times, len(some) / len(gaps), float(some.mean()) * 1e3, float(some.std()) * 1e3))
    return tuple(found)


def _windows(t: FloatArray, counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    whole = len(t) // WINDOW * WINDOW
    return t[:whole].reshape(-1, WINDOW), counts[:whole].reshape(-1, WINDOW)


def _stroke(touch: Sequence[PadReport]) -> Stroke:
    rows = [(packet.t_first, packet.x_counts, packet.y_counts, packet.pressure) for packet in touch]
    t, x, y, pressure = np.array(rows, dtype=np.float64).T
    return Stroke(t, x, y, pressure)


def _on_pad(stroke: Stroke, config: PadConfig) -> Stroke:
    """Without the reports that the daemon would not take for a contact either."""
    s_mm = position_mm(stroke.counts(config.axis), config.axis, config)
    on = (s_mm > 0.0) & (s_mm <= config.length_mm + MARGIN_MM)
    return Stroke(stroke.t[on], stroke.x[on], stroke.y[on], stroke.pressure[on])
