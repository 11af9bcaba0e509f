"""The normals of an outline that palms can touch, and the reasons for the others. Pure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palmd.events import FloatArray
from palmd.model.shape import harmonic_of_coefficient
from palmd.model.stable_surface import SurfaceLimits, stable_surface
from palmd.motion.limits import MotionLimits
from palmd.motion.rollout_predictor import BINS, MARGIN_M, Bools

LEAST_OVAL_M = 1e-9
ANYWHERE, ANY_LENGTH_M = ((0.02, 2.9), (0.1, 2.95)), 0.5  # effectively unlimited angles and pads


def surface_limits(limits: MotionLimits) -> SurfaceLimits:
    """Return the limits that matter for an object's stable poses."""
    first, opening = ((bound.low, bound.high) for bound in limits.joint_bounds)
    return SurfaceLimits(first, opening, limits.top, limits.pad_length, MARGIN_M, limits.curvatures)


def reach(outline: FloatArray, limits: SurfaceLimits) -> Bools:
    """Return the bins of normals that a palm touches in some stable pose of `outline`, coefficients of h (m).

    A circle about its centre of mass, which balances everywhere, is replaced by a minimal oval.
    """
    if not outline[1:].any():
        outline = outline.copy()
        outline[harmonic_of_coefficient((len(outline) - 1) // 2) == 2] = LEAST_OVAL_M
    return stable_surface(outline, limits, bins=BINS).reach


def why_not(out: Bools, outline: FloatArray, limits: SurfaceLimits) -> list[str]:
    """Return as texts which limits keep the bins `out` of the outline out of reach."""
    texts = []
    first, opening = ANYWHERE
    free = replace(limits, phi1=first, phi2=opening)
    for wider, why in (
        (free, "the limits of the palm angles"),
        (replace(limits, pad_length=ANY_LENGTH_M), "the pads' length"),
        (replace(free, pad_length=ANY_LENGTH_M, margin=0.0), "these limits and the pads' length together"),
    ):
        opened = out & reach(outline, wider) if out.any() else out
        if opened.any():
            texts.append(f"out of reach because of {why}: {arcs(opened)}")
        out = out & ~opened
    return [*texts, f"in no stable pose: {arcs(out)}"] if out.any() else texts


def arcs(marks: Bools) -> str:
    """Format the marked bins as arcs `from–to°` of the normal."""
    if marks.all():
        return "0–360°"
    width = 360 / BINS
    begins = np.flatnonzero(marks & ~np.roll(marks, 1))
    named = []
    for begin in begins:
        length = int(np.argmin(np.roll(marks, -begin)))
        named.append(f"{begin * width:.0f}–{(begin + length) % BINS * width:.0f}°")
    return ", ".join(named)
