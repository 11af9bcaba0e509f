"""Ellipse parameters of bodies, as physics engines need them. Pure. SI units."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from palmd.rig.shapes import Support, SupportFunction

_EXACT_M = 1e-8  # largest deviation from an ellipse (derivation: rounding gives 1e-16, a bump 1e-5)


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Half axes (m), centre relative to the COM (m), and direction of the first axis (rad), in the body's frame."""

    half_axes: tuple[float, float]
    centre: tuple[float, float]
    tilt: float


def ellipse_of(support: SupportFunction) -> Ellipse:
    """The ellipse with this outline, h(θ) = c·u(θ) + √(a² cos²(θ − tilt) + b² sin²(θ − tilt)).

    Raises ValueError if the outline is no ellipse.
    """
    if isinstance(support, Support):
        first, second = (*support.coefficients, 0j, 0j)[1:3]
        centre, tilt = (first.real, -first.imag), -0.5 * cmath.phase(second)
        centred = support.moved(-centre[0], -centre[1])
        axes = centred.at(tilt)[0], centred.at(tilt + 0.5 * math.pi)[0]
        theta = np.arange(360, dtype=np.float64) * (math.tau / 360)
        h = np.hypot(axes[0] * np.cos(theta - tilt), axes[1] * np.sin(theta - tilt))
        if np.abs(h - centred.sample(theta)).max() < _EXACT_M:
            return Ellipse(axes, centre, tilt)
    raise ValueError("the body is no ellipse")
