"""Which normals of an outline palms can touch, and why they cannot touch the others. Pure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palmd.events import FloatArray
from palmd.model.shape import harmonic_of_coefficient
from palmd.model.stable_surface import SurfaceLimits, stable_surface
from palmd.motion.limits import MotionLimits
from palmd.motion.rollout_predictor import BINS, MARGIN_M, Bools

LEAST_OVAL_M = 1e-9
ANYWHERE, ANY_LENGTH_M = ((0.02, 2.9), (0.1, 2.95)), 0.5  # as if there were no limits


def surface_limits(limits: MotionLimits) -> SurfaceLimits:
    """What the palms may do, as far as it matters for where an object can lie."""
    first, opening = ((bound.low, bound.high) for bound in limits.joint_bounds)
    return SurfaceLimits(first, opening, limits.top, limits.pad_length, MARGIN_M, limits.curvatures)


def reach(outline: FloatArray, limits: SurfaceLimits) -> Bools:
    """The bins of normals that a palm touches in some stable pose of `outline`, coefficients of h (m).

    A circle about its centre of mass, which balances everywhere, is taken for the oval next to it.
    """
    if not outline[1:].any():
        outline = outline.copy()
        outline[harmonic_of_coefficient((len(outline) - 1) // 2) == 2] = LEAST_OVAL_M
    return stable_surface(outline, limits, bins=BINS).reach


def why_not(out: Bools, outline: FloatArray, limits: SurfaceLimits) -> list[str]:
    """In words, why the bins `out` of the outline are out of reach: what would have to be wider to reach them."""
    told = []
    first, opening = ANYWHERE
    free = replace(limits, phi1=first, phi2=opening)
    for wider, why in (
        (free, "the limits of the palm angles"),
        (replace(limits, pad_length=ANY_LENGTH_M), "the pads' length"),
        (replace(free, pad_length=ANY_LENGTH_M, margin=0.0), "these limits and the pads' length together"),
    ):
        opened = out & reach(outline, wider) if out.any() else out
        if opened.any():
            told.append(f"out of reach because of {why}: {arcs(opened)}")
        out = out & ~opened
    return [*told, f"in no stable pose: {arcs(out)}"] if out.any() else told


def arcs(marks: Bools) -> str:
    """The marked bins as arcs `from–to°` of the normal."""
    if marks.all():
        return "0–360°"
    width = 360 / BINS
    begins = np.flatnonzero(marks & ~np.roll(marks, 1))
    named = []
    for begin in begins:
        length = int(np.argmin(np.roll(marks, -begin)))
        named.append(f"{begin * width:.0f}–{(begin + length) % BINS * width:.0f}°")
    return ", ".join(named)
