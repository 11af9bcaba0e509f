"""The surface of all stable poses over the palms' angles (CMU-CS-01-107, section 3.2, figure 3.6): its connected
parts, what each part shows of the outline, and where it ends.

Its points are the stable poses of a grid of palm poses. Two neighbours are joined when a step of the palms leads from
one to the other *and back*; a fall into another pose does not come back. The step is taken at once, so that about one
link in a thousand, next to a boundary, is wrong: `follow` tells before a route is driven. The surface ends inside the
limits where a minimum vanishes, (3.23) and (3.24) both zero: the inside boundary. It ends at the limits of the palm
angles and where a contact leaves its pad: the outside boundary.

On palms that are arcs the grid is one of their tangents, between which an object balances as between flat palms
(`model.stable_on_arcs`): its poses are mapped to the palms', and those that are not stable there are left out.
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
    outline_at,
    touch,
)
from palmd.system.arcs import FLAT
from palmd.system.mechanism import normal_directions

PHI1_COUNT = 60
PHI2_COUNT = 50
NORMAL_BINS = 72
_WOUND = 3.0  # rad: going round a loop turns the object by a multiple of 2π; this tells one from none
_FOLD_SCAN = 720
_LEVEL = 0.02  # rad: tangents that lie flatter hold nothing


@dataclass(frozen=True, slots=True)
class SurfaceLimits:
    """Which poses count: palm angles from low to high (rad), φ12 below its limit (rad), contacts on the pads (m).

    A contact is on its pad from `margin` to `pad_length` − `margin` from the hinge. curvatures: of the palms (1/m).
    """

    phi1: tuple[float, float] = (0.1, 2.6)
    phi2: tuple[float, float] = (0.6, 2.7)
    phi12_max: float = math.radians(172.0)
    pad_length: float = 0.0555
    margin: float = 0.002
    curvatures: tuple[float, ...] = FLAT

    def on_pads(self, s1: FloatArray, s2: FloatArray) -> BoolArray:
        """Whether both contacts, s1 and s2 from the hinge (m), are on their pads."""
        low, high = self.margin, self.pad_length - self.margin
        return (s1 >= low) & (s1 <= high) & (s2 >= low) & (s2 <= high)

    def hold(self, phi1: FloatArray, phi2: FloatArray) -> BoolArray:
        """Whether the palms may stand at these angles (rad)."""
        (low1, high1), (low2, high2) = self.phi1, self.phi2
        inside = (phi1 >= low1) & (phi1 <= high1) & (phi2 >= low2) & (phi2 <= high2)
        return inside & (phi1 + phi2 < self.phi12_max)

    def of_tangents(self) -> tuple[tuple[float, float], tuple[float, float], float]:
        """What β1 and the opening of the tangents can be within them, and what β2 stays below (rad).

        On flat palms the same, but for tangents that lie too flat to hold anything.
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
    """All P allowed stable poses on a grid of palm angles, and the C connected parts that they form.

    Points: phi1, phi2, psi (rad, ψ in [0, 2π)), s1, s2 (m), the number of their component, and whether they lie on
    the outside boundary; all (P,). On arcs φ1 and φ2 are those of the palms, the grid is one of the tangents.
    links: (L, 2), neighbouring points that lead to each other. Components come by the part of the outline that they
    reach, largest first. reach: (C, bins), which of the evenly spaced bins of outward normals, bin 0 beginning at
    θ = 0, a palm touches (3.1). winds: (C,), whether a closed motion of the palms can bring the object once around.
    grid1, grid2: the grid's palm angles. point_of: (len(grid1), len(grid2), K), the point of each minimum, −1 where
    there is none or it is not allowed.
    """

    phi1: FloatArray
    phi2: FloatArray
    psi: FloatArray
    s1: FloatArray
    s2: FloatArray
    component: IntArray
    outside: BoolArray
    links: IntArray
    reach: BoolArray
    winds: BoolArray
    grid1: FloatArray
    grid2: FloatArray
    point_of: IntArray
    basins: Basins

    @property
    def covered(self) -> FloatArray:
        """The share of the outline that each component reaches, (C,), 0…1."""
        return np.asarray(self.reach.mean(axis=1), dtype=np.float64)


def stable_surface(
    coefficients: FloatArray,
    limits: SurfaceLimits | None = None,
    *,
    phi1_count: int = PHI1_COUNT,
    phi2_count: int = PHI2_COUNT,
    bins: int = NORMAL_BINS,
) -> Surface:
    """The surface of stable poses of the outline with these Fourier coefficients (m) about its centre of mass.

    A grid step of 0.05 rad or less follows the surface well. Fast enough for a thread beside the loop, not for the
    loop. A circle about its centre of mass balances everywhere and has no such surface: it is empty. Raises ValueError
    when the limits leave no palm pose.
    """
    limits = limits or SurfaceLimits()
    first, second, top = limits.of_tangents()
    grid1, grid2 = np.linspace(*first, phi1_count), np.linspace(*second, phi2_count)
    open_ = np.add.outer(grid1, grid2) < top
    if not open_.any():
        raise ValueError("the limits leave no palm pose: phi1 + phi2 is too large everywhere")
    row, column = np.nonzero(open_)
    extrema = _on_grid(basins(coefficients, grid1[row], grid2[column]), open_)

    # every stable pose gets a number; only those with both contacts on the pads stay in the surface
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

    point = np.where(allowed, np.cumsum(allowed) - 1, -1)
    links = point[all_links[both]]
    outside = _at_the_edge(open_)[i, j]
    outside[all_links[~both].ravel()] = True
    point_of = np.append(point, -1)[number]
    psi = psi[allowed]
    component, reach, winds = _components(beta1[allowed], opening[allowed], psi, links, bins)
    return Surface(
        phi1[allowed], phi2[allowed], psi, s1[allowed], s2[allowed], component, outside[allowed],
        links, reach, winds, grid1, grid2, point_of, extrema,
    )  # fmt: skip


def point_at(surface: Surface, coefficients: FloatArray, phi1: float, phi2: float, psi: float) -> int:
    """The surface's point next to where the object rests at these angles of flat palms (rad) when let go at ψ (rad).

    Tried are the corners of the grid's cell around, nearest first, joined as neighbours are; −1 where none is:
    outside the limits, or next to a boundary. `surface.component` tells the part of the surface. Raises ValueError
    as `height_series` does.
    """
    here = basins(coefficients, np.asarray(phi1), np.asarray(phi2))
    place = here.index(np.asarray([psi]))
    if place[0] < 0:
        return -1
    rest = here.minima[place]
    corners = [(i, j) for i in _around(surface.grid1, phi1) for j in _around(surface.grid2, phi2)]
    corners.sort(key=lambda ij: math.hypot(surface.grid1[ij[0]] - phi1, surface.grid2[ij[1]] - phi2))
    for i, j in corners:
        there = surface.basins.at((i, j))
        k = there.index(rest)
        if k[0] >= 0 and here.index(there.minima[k])[0] == place[0] and surface.point_of[i, j, k[0]] >= 0:
            return int(surface.point_of[i, j, k[0]])
    return -1


def inside_boundary(coefficients: FloatArray, limits: SurfaceLimits, phi2: FloatArray) -> FloatArray:
    """Poses (φ1, φ2, ψ) (rad) where a minimum vanishes, at each of the given φ2 (rad): (F, 3), within the limits.

    Balance needs d1 + λ d2 = 0 and a vanishing minimum h1″ + λ h2″ = 0, both with λ = sin φ1 / sin φ12: so
    d1 h2″ = d2 h1″ ((3.23) and (3.24) without φ1), which θ1 and φ2 decide alone; then λ = −d1/d2 gives
    φ1 = atan2(λ sin φ2, 1 − λ cos φ2).
    """
    theta = np.linspace(0.0, 2 * np.pi, _FOLD_SCAN + 1)
    start1, start2 = np.meshgrid(theta, phi2)
    value = _fold(coefficients, start1, start2)
    row, cell = np.nonzero((value[:, 1:] >= 0) != (value[:, :-1] >= 0))
    at, low, high = np.asarray(phi2)[row], theta[cell], theta[cell + 1]
    rising = value[row, cell + 1] >= 0
    for _ in range(40):
        middle = 0.5 * (low + high)
        below = (_fold(coefficients, middle, at) >= 0) != rising
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    theta1 = 0.5 * (low + high)
    d1 = outline_at(coefficients, theta1)[1]
    d2 = outline_at(coefficients, theta1 + at - np.pi)[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = -d1 / d2
    phi1 = np.arctan2(ratio * np.sin(at), 1 - ratio * np.cos(at))
    psi = np.mod(phi1 - theta1 - np.pi / 2, 2 * np.pi)
    inside = (ratio > 0) & (phi1 >= limits.phi1[0]) & (phi1 <= limits.phi1[1]) & (phi1 + at < limits.phi12_max)
    poses = np.stack([phi1, at, psi], axis=1)[inside]
    contacts = touch(coefficients, *poses.T)
    return poses[limits.on_pads(contacts.s1, contacts.s2)]


def _fold(coefficients: FloatArray, theta1: FloatArray, phi2: FloatArray) -> FloatArray:
    """d1 h2″ − d2 h1″ (m²), with h″ = v − r."""
    r1, d1, v1 = outline_at(coefficients, theta1)
    r2, d2, v2 = outline_at(coefficients, theta1 + phi2 - np.pi)
    return d1 * (v2 - r2) - d2 * (v1 - r1)


def _on_grid(found: Basins, open_: BoolArray) -> Basins:
    """Extrema of the open palm poses laid out on the whole grid, NaN elsewhere."""
    minima = np.full((*open_.shape, found.minima.shape[-1]), np.nan)
    maxima = minima.copy()
    minima[open_], maxima[open_] = found.minima, found.maxima
    return Basins(minima, maxima)


def _links(extrema: Basins, number: IntArray) -> IntArray:
    """Pairs of numbers of neighbouring stable poses that lead to each other, (L, 2)."""
    return np.concatenate([_links_between(extrema, number, *pair) for pair in _NEIGHBOURS])


_NEIGHBOURS = (
    ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
    ((slice(None, -1), slice(None, -1)), (slice(1, None), slice(1, None))),
    ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))),
)
"""The grid's sides and diagonals, without which narrow necks look torn: palm poses, and the one next to each."""


def _links_between(
    extrema: Basins, number: IntArray, here: tuple[slice, slice], there: tuple[slice, slice]
) -> IntArray:
    """Those between `here` and `there`, which are as many palm poses."""
    one, two = extrema.at(here), extrema.at(there)
    forth, back = two.index(one.minima), one.index(two.minima)
    own = np.arange(forth.shape[-1])
    ends = np.take_along_axis(number[there], np.maximum(forth, 0), axis=-1)
    returned = np.take_along_axis(back, np.maximum(forth, 0), axis=-1) == own
    both = np.isfinite(one.minima) & (forth >= 0) & returned
    return np.stack([number[here][both], ends[both]], axis=1)


def _at_the_edge(open_: BoolArray) -> BoolArray:
    """Palm poses of the grid that have a neighbour outside the limits of the palm angles."""
    padded = np.pad(open_, 1)
    return ~(padded[2:, 1:-1] & padded[:-2, 1:-1] & padded[1:-1, 2:] & padded[1:-1, :-2])


def _components(
    phi1: FloatArray, phi2: FloatArray, psi: FloatArray, links: IntArray, bins: int
) -> tuple[IntArray, BoolArray, BoolArray]:
    """(component of each point, reach, winds), the components sorted by their reach, then by their size."""
    component, lifted = _trees(psi, links)
    count = int(component.max(initial=-1)) + 1
    reach = _reach(normal_directions((phi1, phi2), psi), links, component, count, bins)
    size = np.bincount(component, minlength=count)
    order = np.lexsort((-size, -reach.sum(axis=1)))
    rank = np.empty(count, dtype=np.intp)
    rank[order] = np.arange(count)
    component = rank[component]
    return component, reach[order], _winds(psi, lifted, links, component, count)


def _reach(theta: tuple[FloatArray, ...], links: IntArray, component: IntArray, count: int, bins: int) -> BoolArray:
    """Bins of normals between both ends of each link, and those of each point, (count, bins)."""
    width = 2 * np.pi / bins
    ends = np.concatenate([links, np.repeat(np.arange(len(component)), 2).reshape(-1, 2)])
    steps = np.zeros((count, 2 * bins + 1))
    for normal in theta:
        one = np.mod(normal[ends[:, 0]], 2 * np.pi)
        two = nearest_turn(normal[ends[:, 1]], one)
        first = np.floor(np.minimum(one, two) / width).astype(np.intp)
        length = np.floor(np.maximum(one, two) / width).astype(np.intp) - first + 1
        first %= bins
        np.add.at(steps, (component[ends[:, 0]], first), 1)
        np.add.at(steps, (component[ends[:, 0]], first + length), -1)
    marked = np.cumsum(steps, axis=1)[:, :-1] > 0
    return marked[:, :bins] | marked[:, bins:]


def _trees(psi: FloatArray, links: IntArray) -> tuple[IntArray, FloatArray]:
    """The component of each point, and its ψ made continuous along a tree of links from the component's first point."""
    both = np.concatenate([links, links[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    starts, others = np.searchsorted(both[:, 0], np.arange(len(psi) + 1)).tolist(), both[:, 1].tolist()
    own, lifted, component, count = psi.tolist(), psi.tolist(), [-1] * len(psi), 0
    for root in range(len(own)):
        if component[root] >= 0:
            continue
        component[root] = count
        reached = [root]
        for point in reached:  # which grows meanwhile: in order of the distance from the root
            here = lifted[point]
            for other in others[starts[point] : starts[point + 1]]:
                if component[other] < 0:
                    component[other] = count
                    lifted[other] = own[other] + math.tau * round((here - own[other]) / math.tau)
                    reached.append(other)
        count += 1
    return np.array(component, dtype=np.intp), np.array(lifted)


def _winds(psi: FloatArray, lifted: FloatArray, links: IntArray, component: IntArray, count: int) -> BoolArray:
    """Whether a loop of links turns the object once around, for each component.

    With ψ continuous along a tree of links (`lifted`) a link that closes a loop then shows a whole turn.
    """
    winds = np.zeros(count, dtype=np.bool_)
    turned = nearest_turn(psi[links[:, 1]], psi[links[:, 0]]) - psi[links[:, 0]]
    wrong = np.abs(lifted[links[:, 1]] - lifted[links[:, 0]] - turned) > _WOUND
    winds[component[links[wrong, 0]]] = True
    return winds


def _around(grid: FloatArray, value: float) -> tuple[int, ...]:
    """The grid's two values around this one; none outside."""
    if not grid[0] <= value <= grid[-1]:
        return ()
    after = min(max(int(np.searchsorted(grid, value)), 1), len(grid) - 1)
    return after - 1, after
