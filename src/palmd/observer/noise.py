"""How much readings scatter about any smooth motion, whatever the rig's description says of their noise. Pure.

Between four readings in a row a quadratic leaves one contrast, their third divided difference; a contact moves so
smoothly that noise is all that is in it: the sensor's, what stamps that jitter make of its motion, and vibration.
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
    ratio = _scatter(t, np.array([sample.s for sample in samples])) / np.sqrt(pad.reading_variance)
    if ratio > DEADBAND:
        variance = min(ratio, MOST) ** 2 * pad.reading_variance
        pad = replace(pad, noise=float(np.sqrt(variance - pad.resolution**2 / 12)))
    pressed = [sample for sample in samples if sample.force]
    if len(pressed) < LEAST_READINGS:
        return pad
    t, force = np.array([(sample.t_sample, sample.force) for sample in pressed]).T
    told = _scatter(t, force / np.sqrt(pad.force_variance(np.full(len(force), median(force)))))
    return replace(pad, force_scale_std=pad.force_scale_std * min(told, MOST)) if told > DEADBAND else pad


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
