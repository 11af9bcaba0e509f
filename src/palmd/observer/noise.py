"""How much readings scatter about any smooth motion, whatever the rig's description says of their noise. Pure.

Between four readings in a row a quadratic leaves one contrast, their third divided difference; a contact moves so
smoothly that noise is all that is in it: the sensor's, what stamps that jitter make of its motion, and vibration.
Where stamps are an adapter's rather than the pad's, each reading is also as uncertain as the contact moves within the
adapter's period.
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

LEAST_READINGS = 40  # of a pad: from fewer its noise is told to no better than a fifth
DEADBAND = 1.2  # ratio of standard deviations up to which a description is right
MOST = 10.0  # that readings of a pad in order scatter more than described
ROW = 4
REFINEMENTS = 3
RATE_READINGS = 9
"""Readings that a rate is computed from (derivation: at 100 a second, 0.1 mm of noise is 1.3 mm/s of rate, 6 µm in a
stamp's error of 4.6 ms; in 0.1 s a contact's rate is nearly constant)."""
ADAPTER_S = 0.016
"""Period (s) in which a USB adapter of FTDI delivers what has come (data sheet: default of the latency timer)."""
STEADY_READINGS = 500
"""Readings within which the adapter's phase counts as constant (derivation: clocks 100 ppm apart drift by 0.5 ms in the
5 s of so many readings, 3 % of the period)."""
CHANCE = 1e-6
"""Level of Rayleigh's test: the probability that stamps without a period are taken for batches."""
MAP_READINGS = 10.0
"""Readings that share a smooth error of place, for a search that has no map of it (study 2026-11-29, seeds 9001 to 9003
and 9200 to 9211: by one, a log of 70 µm was not explained; by 40, one did not settle)."""
_NORMAL_MEDIAN = 0.455  # of x², x standard normal


def with_scatter(rig: RigDescription, samples: Sequence[PadSample]) -> RigDescription:
    """The rig, its pads as noisy as their readings show; less than is described is not believed."""
    pads = []
    for number, pad in zip(PALMS, rig.pads, strict=True):
        mine = [sample for sample in samples if sample.pad == number]
        pads.append(scattered(pad, mine) if len(mine) >= LEAST_READINGS else pad)
    return replace(rig, pads=tuple(pads))


def scattered(pad: PadSensor, samples: Sequence[PadSample]) -> PadSensor:
    """The pad as noisy as its readings show; less than is described is not believed."""
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
    if stamp_sd > 0.0:  # late by anything up to the period, so that the mean delay is unknown too
        pad = replace(pad, lag_sd=math.hypot(pad.lag_sd, ADAPTER_S / 2.0))
    pressed = [sample for sample in samples if sample.force]
    if len(pressed) < LEAST_READINGS:
        return pad
    t, force = np.array([(sample.t_sample, sample.force) for sample in pressed]).T
    told = _scatter(t, force / np.sqrt(pad.force_variance(np.full(len(force), median(force)))))
    return replace(pad, force_scale_std=pad.force_scale_std * min(told, MOST)) if told > DEADBAND else pad


def map_as_noise(rig: RigDescription, readings: float = 1.0) -> RigDescription:
    """The rig for who knows of smooth errors of place as of noise only.

    readings: how many share an error. By one each reading by itself is as uncertain as it is; bands of what
    many tell together are then too narrow.
    """
    return replace(rig, pads=tuple(_noisier(pad, readings * pad.map_sd**2) for pad in rig.pads))


def without_map(rig: RigDescription) -> RigDescription:
    """The rig for who knows nothing of smooth errors of place."""
    return replace(rig, pads=tuple(_noisier(pad, 0.0) for pad in rig.pads))


def _noisier(pad: PadSensor, variance: float) -> PadSensor:
    """The pad, its smooth error of place counted as so much variance of each reading (m²)."""
    noise = math.sqrt(pad.noise**2 - pad.map_noise**2 + variance)
    return replace(pad, noise=noise, map_noise=math.sqrt(variance))


def rates(t: FloatArray, values: FloatArray) -> FloatArray:
    """How fast readings at `t` (s) change, by a line through each and its neighbours (values a second)."""
    if len(t) < 2:
        return np.zeros(len(t))
    width = min(RATE_READINGS, len(t))
    first = np.clip(np.arange(len(t)) - width // 2, 0, len(t) - width)
    at = first[:, None] + np.arange(width)
    times = t[at] - t[at].mean(axis=1, keepdims=True)
    found: FloatArray = (times * values[at]).sum(axis=1) / np.maximum((times**2).sum(axis=1), 1e-12)
    return found


def batched(t: FloatArray) -> bool:
    """Whether stamps `t` (s) keep to the period in which a USB adapter delivers, by Rayleigh's test of their phases."""
    phases = np.exp(2j * np.pi * t / ADAPTER_S)
    pieces = [phases[at : at + STEADY_READINGS] for at in range(0, len(t), STEADY_READINGS)]
    evidence = [len(piece) * abs(piece.mean()) ** 2 for piece in pieces if len(piece) >= LEAST_READINGS]
    return bool(evidence) and median(np.array(evidence)) > -math.log(CHANCE)


def _scatter(t: FloatArray, values: FloatArray) -> float:
    """Standard deviation of readings about a smooth course, without those that a fit takes for outliers."""
    windows = np.lib.stride_tricks.sliding_window_view
    times, values = windows(t, ROW), windows(values, ROW)
    apart = times[:, :, None] - times[:, None, :] + np.eye(ROW)
    weights = 1.0 / apart.prod(axis=2)
    squares = (weights * values).sum(axis=1) ** 2 / (weights**2).sum(axis=1)
    variance = median(squares) / _NORMAL_MEDIAN
    for _ in range(REFINEMENTS):
        variance = float(squares[squares <= GATE * variance].mean()) if variance > 0.0 else 0.0
    return math.sqrt(variance)
