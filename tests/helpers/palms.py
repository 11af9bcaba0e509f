"""Palm motions and reports from flat rows of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from palmd.events import PalmMotion, PalmSample


def motion_of(values: Iterable[float]) -> PalmMotion:
    """φ1, φ2 and, where not zero, their rates and accelerations."""
    flat = tuple(values)
    flat += (0.0,) * (6 - len(flat))
    return PalmMotion(flat[:2], flat[2:4], flat[4:])


def palm_sample(line: Mapping) -> PalmSample:
    """An event log's line of the palms that has rates and accelerations."""
    flat = tuple(line["palms"].values())
    return PalmSample(line["t"], flat[:2], flat[2:4], flat[4:])
