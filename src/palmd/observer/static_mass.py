"""Mass of an object at rest (CMU-CS-01-107, end of section 4.1), without a model of its shape. Pure."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from palmd.events import Event, FloatArray, PadSample, PalmSample
from palmd.observer.mass import MassEstimator, resting_forces
from palmd.system.arcs import tangents
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS

SPAN_S = 0.5  # tested for rest as a whole
STILL_M_S, STILL_RAD_S = 1.5e-3, 0.01  # limits of rest, of contacts and of palm angles
LEAST_READINGS = 10


def mass_at_rest(events: Iterable[Event], rig: RigDescription) -> MassEstimator:
    """The mass from all spans in which palms and contacts are at rest; its value is NaN when there is none.

    With a0 = 0 in (4.5), m g = −(Fc1 + Fc2): each pad's force is m f of `resting_forces`. Friction is neglected; a
    dither makes that right on average, and without dither the result for a sticking object may be wrong by a fraction
    of μ.
    """
    mass = MassEstimator(rig.pads)
    for palms, pads in _spans(events):
        if not _still(palms, pads):
            continue
        contacts = [float(readings[:, 1].mean()) for readings in pads]
        angles = tangents(palms[:, 1:].mean(axis=0).tolist(), contacts, rig.curvatures)
        for pad, readings, f in zip(PALMS, pads, resting_forces(rig.gravity, angles), strict=True):
            for force in readings[np.isfinite(readings[:, 2]), 2]:
                mass.feed(pad, float(force), f)
    return mass


def _spans(events: Iterable[Event]) -> Iterable[tuple[FloatArray, tuple[FloatArray, ...]]]:
    """Reports (t, angles) and all pads' readings (t, s, force or NaN) of each `SPAN_S` with enough of all."""
    samples = [event for event in events if isinstance(event, PadSample | PalmSample)]
    numbers = [int((sample.t_sample - samples[0].t_sample) // SPAN_S) for sample in samples]
    for number in sorted(set(numbers)):
        some = [sample for sample, n in zip(samples, numbers, strict=True) if n == number]
        palms = np.array([(e.t_sample, *e.angles) for e in some if isinstance(e, PalmSample)])
        pads = tuple(
            np.array(
                [
                    (e.t_sample, e.s, np.nan if e.force is None else e.force)
                    for e in some
                    if isinstance(e, PadSample) and e.pad == pad
                ]
            )
            for pad in PALMS
        )
        if min(map(len, (palms, *pads))) >= LEAST_READINGS:
            yield palms, pads


def _still(palms: FloatArray, pads: tuple[FloatArray, ...]) -> bool:
    contacts = all(abs(_slope(readings[:, 0], readings[:, 1])) < STILL_M_S for readings in pads)
    return contacts and all(
        abs(_slope(palms[:, 0], palms[:, column])) < STILL_RAD_S for column in range(1, palms.shape[1])
    )


def _slope(t: FloatArray, values: FloatArray) -> float:
    """Slope of the least-squares line."""
    centred = t - t.mean()
    return float(centred @ values / max(centred @ centred, 1e-12))
