"""An outline as curves in millimetres for CAD: the outline, its uncertainty band, its untouched arcs. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.chords import STRAIGHT_LABEL, chords_of
from palmd.events import FloatArray
from palmd.polygon import boundary, normals, resampled, turned

Bools = npt.NDArray[np.bool_]

SDS = 2.0
"""Half-width of the band in standard deviations."""
_NORMALS = 720  # chords then deviate by 2 µm from an arc of 200 mm radius


@dataclass(frozen=True, slots=True)
class OutlineCurves:
    """Points (n, 2) in mm of three closed curves, counter-clockwise, the first point not repeated.

    Frame of the object: the origin is described by `origin`, the orientation is arbitrary. outer, inner: `SDS` standard
    deviations to either side along each point's normal. normal (n,): direction of that normal (rad). sd (n,): standard
    deviation in mm. touched (n,). chords: both ends (2, 2) of each straight part, in mm. rho_mm, mass_kg: NaN if
    unknown.
    """

    name: str
    outline: FloatArray
    outer: FloatArray
    inner: FloatArray
    normal: FloatArray
    sd: FloatArray
    touched: Bools
    rho_mm: float = math.nan
    mass_kg: float = math.nan
    chords: tuple[FloatArray, ...] = ()
    origin: str = "the object's centre of mass"

    @property
    def untouched(self) -> tuple[FloatArray, ...]:
        """The untouched arcs (k, 2) in mm, including the touched points at their ends."""
        n = len(self.touched)
        if not self.touched.any():
            return (np.concatenate([self.outline, self.outline[:1]]),)
        begins = np.flatnonzero(self.touched & ~np.roll(self.touched, -1))
        ends = np.flatnonzero(self.touched & ~np.roll(self.touched, 1))
        arcs = []
        for begin in begins.tolist():
            length = int(np.min((ends - begin - 1) % n)) + 1
            arcs.append(self.outline[np.arange(begin, begin + length + 1) % n])
        return tuple(arcs)

    @property
    def comments(self) -> tuple[str, ...]:
        """Lines that explain the curves to a reader of the file."""
        return (
            f"palmd: {self.name}",
            f"units: mm; origin: {self.origin}; orientation: arbitrary",
            f"band: ± {SDS:g} standard deviations along the normal",
            f"touched: {np.mean(self.touched):.1%} of the normals; the rest follows from the smoothness prior only",
            *(f"straight over {math.dist(*chord):.2f} mm of the hull: {STRAIGHT_LABEL}" for chord in self.chords),
        )


def curves_factory(
    theta: FloatArray,
    h: FloatArray | None,
    h_sd: FloatArray | None,
    touched: Bools | None,
    *,
    rho_m: float = math.nan,
    mass_kg: float = math.nan,
) -> Callable[[str], OutlineCurves] | None:
    """`curves_of` with only the name left to give; None if there is no outline."""
    if h is None or h_sd is None or touched is None:
        return None
    return lambda name: curves_of(name, theta, h, h_sd, touched, rho_m=rho_m, mass_kg=mass_kg)


def curves_of(
    name: str,
    theta: FloatArray,
    h: FloatArray,
    h_sd: FloatArray,
    touched: Bools,
    *,
    rho_m: float = math.nan,
    mass_kg: float = math.nan,
    origin: str = "the object's centre of mass",
) -> OutlineCurves:
    """The curves of a support function h (m) on normals theta (rad), evenly spaced over the full circle.

    h_sd (m), touched: on the same normals.
    """
    fine: FloatArray = np.arange(_NORMALS, dtype=np.float64) * (math.tau / _NORMALS)  # from theta[0] on
    points = boundary(resampled(h, _NORMALS)) @ turned(float(theta[0])) * 1e3
    coarse = np.arange(len(h)) * (math.tau / len(h))
    sd = np.interp(fine, coarse, h_sd, period=math.tau) * 1e3
    nearest = np.rint(fine / math.tau * len(h)).astype(int) % len(h)
    normal: FloatArray = (fine + float(theta[0])) % math.tau
    chords = tuple(np.array([chord.begin, chord.end]) * 1e3 for chord in chords_of(theta, h, touched))
    reach = (SDS * sd)[:, None] * normals(normal)
    return OutlineCurves(
        name,
        points,
        points + reach,
        points - reach,
        normal,
        sd,
        touched[nearest],
        rho_m * 1e3,
        mass_kg,
        chords,
        origin,
    )
