"""The surface of all stable poses over the palms' angles (CMU-CS-01-107, section 3.2, figure 3.6), and which normals of
the outline it reaches.

Its points are the stable poses on a grid of palm poses. Two neighbours are linked if a step of the palms leads from one
to the other *and back*; a fall into another pose is not reversible. The step is taken at once, so that about one link
in a thousand, next to a boundary, is wrong. The surface ends where a minimum vanishes, (3.23) and (3.24) both zero, at
the limits of the palm angles, and where a contact leaves its pad.

For arc-shaped palms the grid is one of their tangents, between which an object balances as between flat palms
(`model.stable_on_arcs`): poses are mapped to the palms, and those that are not stable there are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model.stable_on_arcs import on_arcs
from palmd.model.stable_poses import (
    Basins,
    BoolArray,
    IntArray,
    basins,
    nearest_turn,
    touch,
)
from palmd.system.arcs import FLAT
from palmd.system.mechanism import normal_directions

PHI1_COUNT = 60
PHI2_COUNT = 50
NORMAL_BINS = 72
_LEVEL = 0.02  # rad: flatter tangents hold no object


@dataclass(frozen=True, slots=True)
class SurfaceLimits:
    """Allowed poses: ranges of the palm angles (rad), limit of φ12 (rad), contacts on the pads (m).

    A contact is on its pad from `margin` to `pad_length` − `margin` from the hinge. curvatures: of the palms (1/m).
    """

    phi1: tuple[float, float] = (0.1, 2.6)
    phi2: tuple[float, float] = (0.6, 2.7)
    phi12_max: float = math.radians(172.0)
    pad_length: float = 0.0555
    margin: float = 0.002
    curvatures: tuple[float, ...] = FLAT

    def on_pads(self, s1: FloatArray, s2: FloatArray) -> BoolArray:
        """Whether both contacts, at s1 and s2 from the hinge (m), are on their pads."""
        low, high = self.margin, self.pad_length - self.margin
        return (s1 >= low) & (s1 <= high) & (s2 >= low) & (s2 <= high)

    def hold(self, phi1: FloatArray, phi2: FloatArray) -> BoolArray:
        """Whether these palm angles (rad) are allowed."""
        (low1, high1), (low2, high2) = self.phi1, self.phi2
        inside = (phi1 >= low1) & (phi1 <= high1) & (phi2 >= low2) & (phi2 <= high2)
        return inside & (phi1 + phi2 < self.phi12_max)

    def of_tangents(self) -> tuple[tuple[float, float], tuple[float, float], float]:
        """Ranges of β1 and of the tangents' opening, and the upper limit of β2 (rad), that cover all allowed poses.

        For flat palms these are the limits themselves, except for tangents too flat to hold an object.
        """
        if not any(self.curvatures):
            return (max(self.phi1[0], _LEVEL), self.phi1[1]), self.phi2, self.phi12_max
        turns = [kappa * self.pad_length for kappa in self.curvatures]  # at the pads' ends; at the hinge, none
        backward, forward = ([each(turn, 0.0) for turn in turns] for each in (min, max))
        low, high = self.phi1[0] + backward[0], self.phi1[1] + forward[0]
        least, most = self.phi2[0] - sum(forward), self.phi2[1] - sum(backward)
        top = min(self.phi12_max - backward[1], math.pi - _LEVEL)
        return (max(low, _LEVEL), min(high, top)), (max(least, _LEVEL), min(most, top)), top


@dataclass(frozen=True, slots=True)
class Surface:
    """All P allowed stable poses on a grid of palm angles, and the normals of the outline that they reach.

    Points: phi1, phi2, psi (rad, ψ in [0, 2π)) and s1, s2 (m); all (P,). For arcs φ1 and φ2 are those of the palms,
    while the grid is one of the tangents. links: (L, 2), neighbouring points that lead to each other. reach: (bins,),
    which of the evenly spaced bins of outward normals, bin 0 beginning at θ = 0, a palm touches (3.1).
    """

    phi1: FloatArray
    phi2: FloatArray
    psi: FloatArray
    s1: FloatArray
    s2: FloatArray
    links: IntArray
    reach: BoolArray


def stable_surface(
    coefficients: FloatArray,
    limits: SurfaceLimits | None = None,
    *,
    phi1_count: int = PHI1_COUNT,
    phi2_count: int = PHI2_COUNT,
    bins: int = NORMAL_BINS,
) -> Surface:
    """Compute the surface of stable poses of an outline with these Fourier coefficients (m) about its centre of mass.

    Grid steps of 0.05 rad or less resolve the surface well. Fast enough for a thread beside the loop, not for the loop.
    The surface is empty for a circle about its centre of mass, which balances everywhere. Raises ValueError if the
    limits leave no palm pose.
    """
    limits = limits or SurfaceLimits()
    first, second, top = limits.of_tangents()
    grid1, grid2 = np.linspace(*first, phi1_count), np.linspace(*second, phi2_count)
    open_ = np.add.outer(grid1, grid2) < top
    if not open_.any():
        raise ValueError("the limits leave no palm pose: phi1 + phi2 is too large everywhere")
    row, column = np.nonzero(open_)
    extrema = _on_grid(basins(coefficients, grid1[row], grid2[column]), open_)

    # number all stable poses; only those with both contacts on the pads stay in the surface
    i, j, k = np.nonzero(np.isfinite(extrema.minima))
    beta1, opening, psi = grid1[i], grid2[j], extrema.minima[i, j, k]
    contacts = touch(coefficients, beta1, opening, psi)
    phi1, phi2, s1, s2 = beta1, opening, contacts.s1, contacts.s2
    allowed = limits.on_pads(s1, s2)
    if any(limits.curvatures):
        laid = on_arcs(contacts, beta1, opening, limits.curvatures)
        phi1, phi2, s1, s2 = laid.phi1, laid.phi2, laid.s1, laid.s2
        allowed = limits.on_pads(s1, s2) & limits.hold(phi1, phi2) & laid.stable
    number = np.full(extrema.minima.shape, -1, dtype=np.intp)
    number[i, j, k] = np.arange(len(psi))
    all_links = _links(extrema, number)
    both = allowed[all_links].all(axis=1)

    links = (np.cumsum(allowed) - 1)[all_links[both]]
    psi = psi[allowed]
    reach = _reach(normal_directions((beta1[allowed], opening[allowed]), psi), links, bins)
    return Surface(phi1[allowed], phi2[allowed], psi, s1[allowed], s2[allowed], links, reach)


def _on_grid(found: Basins, open_: BoolArray) -> Basins:
    """Scatter the extrema of allowed palm poses to the whole grid; NaN elsewhere."""
    minima = np.full((*open_.shape, found.minima.shape[-1]), np.nan)
    maxima = minima.copy()
    minima[open_], maxima[open_] = found.minima, found.maxima
    return Basins(minima, maxima)


def _links(extrema: Basins, number: IntArray) -> IntArray:
    """(L, 2) numbers of neighbouring stable poses that lead to each other."""
    return np.concatenate([_links_between(extrema, number, *pair) for pair in _NEIGHBOURS])


_NEIGHBOURS = (
    ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
    ((slice(None, -1), slice(None, -1)), (slice(1, None), slice(1, None))),
    ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))),
)
"""Neighbours along the grid's sides and diagonals; without diagonals narrow necks of the surface look torn."""


def _links_between(
    extrema: Basins, number: IntArray, here: tuple[slice, slice], there: tuple[slice, slice]
) -> IntArray:
    """Links between `here` and `there`, two shifted slices of the grid."""
    one, two = extrema.at(here), extrema.at(there)
    forth, back = two.index(one.minima), one.index(two.minima)
    own = np.arange(forth.shape[-1])
    ends = np.take_along_axis(number[there], np.maximum(forth, 0), axis=-1)
    returned = np.take_along_axis(back, np.maximum(forth, 0), axis=-1) == own
    both = np.isfinite(one.minima) & (forth >= 0) & returned
    return np.stack([number[here][both], ends[both]], axis=1)


def _reach(theta: tuple[FloatArray, ...], links: IntArray, bins: int) -> BoolArray:
    """(bins,) bins of normals at each point and between both ends of each link."""
    width = 2 * np.pi / bins
    ends = np.concatenate([links, np.repeat(np.arange(len(theta[0])), 2).reshape(-1, 2)])
    steps = np.zeros(2 * bins + 1)
    for normal in theta:
        one = np.mod(normal[ends[:, 0]], 2 * np.pi)
        two = nearest_turn(normal[ends[:, 1]], one)
        first = np.floor(np.minimum(one, two) / width).astype(np.intp)
        length = np.floor(np.maximum(one, two) / width).astype(np.intp) - first + 1
        first %= bins
        np.add.at(steps, first, 1)
        np.add.at(steps, first + length, -1)
    marked = np.cumsum(steps)[:-1] > 0
    return marked[:bins] | marked[bins:]
