"""Noise of a pad estimated from the scatter of its readings about a smooth motion. Pure.

A quadratic through four consecutive readings leaves one contrast, their third divided difference. A contact moves so
smoothly that this contains only noise: of the sensor, of jittering time stamps, and of vibration. If the stamps come
from an adapter rather than the pad, each reading is also uncertain by the contact's motion within the adapter's period.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palmd.events import FloatArray, PadSample
from palmd.observer.median import median
from palmd.observer.reduction import GATE
from palmd.system.description import PadSensor, RigDescription
from palmd.system.mechanism import PALMS

LEAST_READINGS = 40  # of a pad; with fewer the relative error of its noise exceeds a fifth
DEADBAND = 1.2  # ratio of standard deviations up to which the described noise is kept
MOST = 10.0  # largest ratio of estimated to described noise
ROW = 4  # consecutive readings in a contrast
REFINEMENTS = 3  # iterations of outlier rejection
RATE_READINGS = 9
"""Readings that a rate is computed from (derivation: at 100 Hz, 0.1 mm of noise gives 1.3 mm/s of rate, i.e. 6 µm for a
stamp's error of 4.6 ms; within 0.1 s a contact's rate is nearly constant)."""
ADAPTER_S = 0.016
"""Period (s) with which an FTDI USB adapter delivers received data (data sheet: default of the latency timer)."""
STEADY_READINGS = 500
"""Readings within which the adapter's phase is taken as constant (derivation: clocks that differ by 100 ppm drift by
0.5 ms in the 5 s of so many readings, 3 % of the period)."""
CHANCE = 1e-6
"""Significance level of the Rayleigh test: probability that stamps without a period are taken for batches."""
MAP_READINGS = 10.0
"""Readings that share a smooth position error, for a search without a map of it (study 2026-11-29, seeds 9001 to 9003
and 9200 to 9211: with 1, a log of 70 µm was not explained; with 40, one did not settle)."""
_NORMAL_MEDIAN = 0.455  # median of x² for a standard normal x


def with_scatter(rig: RigDescription, samples: Sequence[PadSample]) -> RigDescription:
    """The rig with its pads' noise estimated from `samples`; never less than described."""
    pads = []
    for number, pad in zip(PALMS, rig.pads, strict=True):
        mine = [sample for sample in samples if sample.pad == number]
        pads.append(scattered(pad, mine) if len(mine) >= LEAST_READINGS else pad)
    return replace(rig, pads=tuple(pads))


def scattered(pad: PadSensor, samples: Sequence[PadSample]) -> PadSensor:
    """The pad with its noise estimated from `samples`; never less than described."""
    t = np.array([sample.t_sample for sample in samples])
    s = np.array([sample.s for sample in samples])
    described = pad.reading_variance
    stamp_sd = ADAPTER_S / math.sqrt(12.0) if batched(t) else 0.0
    blur = stamp_sd * math.sqrt(np.mean(rates(t, s) ** 2))
    ratio = _scatter(t, s) / math.sqrt(described)
    variance = min(ratio, MOST) ** 2 * described if ratio > DEADBAND else described
    if blur > 0.0 or variance > described:
        noise = math.sqrt(max(variance, described + blur**2) - pad.resolution**2 / 12)
        pad = replace(pad, noise=noise, stamp_sd=stamp_sd, blur=blur)
    if stamp_sd > 0.0:  # the delay is anything up to the period, so that its mean is unknown too
        pad = replace(pad, lag_sd=math.hypot(pad.lag_sd, ADAPTER_S / 2.0))
    pressed = [sample for sample in samples if sample.force]
    if len(pressed) < LEAST_READINGS:
        return pad
    t, force = np.array([(sample.t_sample, sample.force) for sample in pressed]).T
    force_ratio = _scatter(t, force / np.sqrt(pad.force_variance(np.full(len(force), median(force)))))
    return replace(pad, force_scale_std=pad.force_scale_std * min(force_ratio, MOST)) if force_ratio > DEADBAND else pad


def map_as_noise(rig: RigDescription, readings: float = 1.0) -> RigDescription:
    """The rig with smooth position errors counted as noise, for estimators without a map of them.

    readings: number of readings that share an error. With 1 the variance of a single reading is right, but
    estimates from many readings are overconfident.
    """
    return replace(rig, pads=tuple(_noisier(pad, readings * pad.map_sd**2) for pad in rig.pads))


def without_map(rig: RigDescription) -> RigDescription:
    """The rig without smooth position errors."""
    return replace(rig, pads=tuple(_noisier(pad, 0.0) for pad in rig.pads))


def _noisier(pad: PadSensor, variance: float) -> PadSensor:
    """The pad with its smooth position error counted as `variance` of each reading (m²)."""
    noise = math.sqrt(pad.noise**2 - pad.map_noise**2 + variance)
    return replace(pad, noise=noise, map_noise=math.sqrt(variance))


def rates(t: FloatArray, values: FloatArray) -> FloatArray:
    """Rates of change of `values` at `t` (s), by a line through each value and its neighbours (1/s)."""
    if len(t) < 2:
        return np.zeros(len(t))
    width = min(RATE_READINGS, len(t))
    first = np.clip(np.arange(len(t)) - width // 2, 0, len(t) - width)
    at = first[:, None] + np.arange(width)
    times = t[at] - t[at].mean(axis=1, keepdims=True)
    found: FloatArray = (times * values[at]).sum(axis=1) / np.maximum((times**2).sum(axis=1), 1e-12)
    return found


def batched(t: FloatArray) -> bool:
    """Whether stamps `t` (s) have the period with which a USB adapter delivers, by a Rayleigh test of their phases."""
    phases = np.exp(2j * np.pi * t / ADAPTER_S)
    pieces = [phases[at : at + STEADY_READINGS] for at in range(0, len(t), STEADY_READINGS)]
    evidence = [len(piece) * abs(piece.mean()) ** 2 for piece in pieces if len(piece) >= LEAST_READINGS]
    return bool(evidence) and median(np.array(evidence)) > -math.log(CHANCE)


def _scatter(t: FloatArray, values: FloatArray) -> float:
    """Standard deviation of readings about a smooth course, without outliers as a fit would reject them."""
    windows = np.lib.stride_tricks.sliding_window_view
    times, values = windows(t, ROW), windows(values, ROW)
    differences = times[:, :, None] - times[:, None, :] + np.eye(ROW)
    weights = 1.0 / differences.prod(axis=2)
    squares = (weights * values).sum(axis=1) ** 2 / (weights**2).sum(axis=1)
    variance = median(squares) / _NORMAL_MEDIAN
    for _ in range(REFINEMENTS):
        variance = float(squares[squares <= GATE * variance].mean()) if variance > 0.0 else 0.0
    return math.sqrt(variance)
