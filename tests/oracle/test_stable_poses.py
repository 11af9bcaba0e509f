"""Stable poses against the emulated plant, numeric differences, a plain scan, and the printed equations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from campaign import nightly
from paper_surface import centre_of_mass, centre_of_rotation, height, inside_boundary, stable_poses
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palmd.events import PalmMotion
from palmd.model.shape import coefficients_of
from palmd.model.stable_poses import basins, nearest_turn, outline_at, touch
from palmd.model.stable_surface import Surface, SurfaceLimits, stable_surface
from palmd.rig import plant
from palmd.rig.shapes import KINDS, Body, random_body
from palmd.system.mechanism import normal_directions
from tools.studies.paper_poses import follow

LIMITS = SurfaceLimits()
CLOSING = ((0.4, 2.0), (0.9, 1.2))  # rad, a path of the palms on which minima vanish
PLANT_PSI = 1e-7  # rad: accuracy of the plant's table of h′


def body(seed: int, kind: str = "nominal") -> Body:
    return random_body(kind, np.random.default_rng(seed))


def outline(body: Body, order: int = 7) -> np.ndarray:
    return coefficients_of(body.support.sample(np.arange(720) * (2 * np.pi / 720)), order)


def palms(rng: np.random.Generator) -> tuple[float, float]:
    phi2 = rng.uniform(0.3, 2.7)
    return rng.uniform(0.1, 3.0 - phi2), phi2


def plain_height(body: Body, phi1: float, phi2: float, psi: np.ndarray) -> np.ndarray:
    """Y of the COM from its distances to both palms, by a linear solve."""
    phi12 = phi1 + phi2
    sides = np.array([[-math.sin(phi1), math.cos(phi1)], [math.sin(phi12), -math.cos(phi12)]])
    h = [body.support.sample(phi1 - psi - math.pi / 2), body.support.sample(phi12 - psi - 3 * math.pi / 2)]
    return np.linalg.solve(sides, np.stack(h))[1]


@pytest.mark.parametrize("kind", KINDS)
def test_stable_poses_are_those_of_the_plant(kind):
    rng = np.random.default_rng(1)
    for seed in range(6):
        one = body(seed, kind)
        for _ in range(10):
            phi1, phi2 = palms(rng)
            theirs = sorted(plant.stable_poses(one, PalmMotion.at_rest((phi1, phi2))))
            assert stable_poses(outline(one, 40), phi1, phi2) == pytest.approx(theirs, abs=PLANT_PSI)


@pytest.mark.parametrize("seed", range(4))
def test_a_damped_plant_comes_to_rest_at_the_minimum_of_its_basin(seed):
    rng = np.random.default_rng(seed)
    one = body(seed)
    phi1, phi2 = 0.7, 1.5
    start = rng.uniform(0, 2 * np.pi)
    rig = slow_plant(one)
    still = PalmMotion.at_rest((phi1, phi2))
    rig.place(still, start)
    for _ in range(6000):
        rig.advance(still, still, 5e-4)
    found = follow(outline(one), np.array([start]), np.array([phi1]), np.array([phi2]))
    assert rig.state.psi == pytest.approx(found.psi[0, 0], abs=2e-3)
    assert not found.jumped.any()


@pytest.mark.parametrize("seed", [0, *nightly(6, 9)])
def test_a_jump_ends_where_the_plant_comes_to_rest(seed):
    one = body(seed)
    coefficients = outline(one)
    start = stable_poses(coefficients, *CLOSING[0])
    found = follow(coefficients, start, *closing(81))
    falls = np.flatnonzero(found.jumped.any(axis=0))
    assert len(falls) >= 2
    steps = 8000
    path = [PalmMotion.at_rest(tuple(phi)) for phi in np.transpose(closing(2 * steps + 1))]
    for column in falls:
        rig = slow_plant(one)
        rig.place(path[0], start[column])
        for i in range(0, 2 * steps, 2):
            rig.advance(path[i + 1], path[i + 2], 2e-3)
        while abs(rig.state.omega0) > 1e-4:  # the last fall may begin at the very end
            rig.advance(path[-1], path[-1], 2e-3)
        assert rig.state.psi == pytest.approx(found.psi[-1, column], abs=2e-3)


def closing(count: int) -> tuple[np.ndarray, np.ndarray]:
    """φ1 and φ2 on the path of `CLOSING`."""
    share = np.linspace(0, 1, count)
    return tuple(a + (b - a) * share for a, b in zip(*CLOSING, strict=True))


def slow_plant(body: Body) -> plant.Plant:
    """A plant so strongly damped that it does not swing past a maximum."""
    surface = plant.FrictionSurface(damping=30 * body.rho**2)
    return plant.Plant(body, plant.Hinge("fixed", base=(0.0, 0.0)), surface)


def test_a_jump_is_marked_in_the_step_where_the_minimum_vanishes():
    coefficients = outline(body(4))
    path1, path2 = closing(201)
    found = follow(coefficients, stable_poses(coefficients, path1[0], path2[0]), path1, path2)
    moved = np.abs(np.diff(found.psi, axis=0))
    assert found.jumped.any()
    assert moved[found.jumped[1:]].min() > 0.1
    for step, column in np.argwhere(found.jumped):
        # the vanished minimum has no neighbour within the range of one step
        before, after = found.psi[step - 1, column], stable_poses(coefficients, path1[step], path2[step])
        assert np.abs(nearest_turn(after, before) - before).min() > 0.05


def test_slope_and_curvature_agree_with_differences_of_the_height():
    rng = np.random.default_rng(3)
    one = body(7)
    for _ in range(20):
        (phi1, phi2), psi, e = palms(rng), rng.uniform(0, 6, 5), 1e-4
        here = height(outline(one), phi1, phi2, psi)
        low, middle, high = (plain_height(one, phi1, phi2, psi + step) for step in (-e, 0.0, e))
        assert here.y == pytest.approx(middle, abs=1e-12)
        assert here.slope == pytest.approx((high - low) / (2 * e), abs=1e-8 / math.sin(phi2))
        assert here.curvature == pytest.approx((high - 2 * middle + low) / e**2, abs=1e-7 / math.sin(phi2))


def test_the_printed_equations_hold():
    """(3.17), (3.18), (3.21), (3.23), (3.24) as printed, at poses out of balance."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        coefficients = outline(body(int(rng.integers(100))))
        phi1, phi2 = (np.asarray(angle) for angle in palms(rng))
        psi = np.asarray(rng.uniform(0, 6))
        here, at = height(coefficients, phi1, phi2, psi), touch(coefficients, phi1, phi2, psi)
        apart = centre_of_mass(at, phi1) - centre_of_rotation(at.s1, at.s2, phi1, phi2)
        assert centre_of_mass(at, phi1)[1] == pytest.approx(here.y, abs=1e-14)
        assert apart[0] == pytest.approx(here.slope, abs=1e-14)

        theta1 = normal_directions((phi1, phi2), psi)[0]
        n, t = np.array([np.cos(theta1), np.sin(theta1)]), np.array([np.sin(theta1), -np.cos(theta1)])
        x1 = at.r1 * n + at.d1 * t
        r2, d2 = -at.s1 * np.sin(phi2), at.s1 * np.cos(phi2) - at.s2  # generalised (3.6)
        balance = -d2 * np.sin(phi1) / np.sin(phi2) - np.array([np.cos(psi), -np.sin(psi)]) @ x1
        bend = (at.v1 * np.sin(phi1 + phi2) + (at.v2 + r2) * np.sin(phi1)) / np.sin(phi2)
        assert balance == pytest.approx(here.slope, abs=1e-14)
        assert bend + np.array([np.sin(psi), np.cos(psi)]) @ x1 == pytest.approx(here.curvature, abs=1e-13)


@pytest.mark.parametrize("seed", [0, *nightly(1, 2, 3)])
def test_no_pose_is_missed_next_to_a_fold(seed):
    """Where two extrema are closer than the scan's points, the count still changes by one."""
    one = body(seed)
    coefficients = outline(one)
    folds = inside_boundary(coefficients, LIMITS, np.linspace(0.8, 2.5, 7))
    assert len(folds) > 5
    at = height(coefficients, *folds.T)
    assert np.abs(at.slope).max() < 1e-9
    assert np.abs(at.curvature).max() < 1e-9
    for phi1, phi2, _ in folds:
        counts = []
        for step in (-2e-5, 2e-5):
            psi = np.arange(30_000) * (2 * np.pi / 30_000)
            y = plain_height(one, phi1 + step, phi2, psi)
            scanned = ((y < np.roll(y, 1)) & (y <= np.roll(y, -1))).sum()
            counts.append(len(stable_poses(coefficients, phi1 + step, phi2)))
            assert counts[-1] == scanned
        assert abs(counts[1] - counts[0]) == 1


def test_slopes_vanish_and_minima_and_maxima_alternate():
    rng = np.random.default_rng(5)
    coefficients = outline(body(11))
    phi = np.array([palms(rng) for _ in range(200)])
    found = basins(coefficients, *phi.T)
    for extrema, sign in ((found.minima, 1), (found.maxima, -1)):
        at = height(coefficients, *phi.T[:, :, None], extrema)
        known = np.isfinite(extrema)
        assert np.abs(at.slope[known]).max() < 1e-13
        assert (sign * at.curvature[known]).min() > 0
    assert (found.count == np.isfinite(found.maxima).sum(axis=-1)).all()
    own = found.index(found.minima)[np.isfinite(found.minima)]
    assert (own == np.nonzero(np.isfinite(found.minima))[1]).all()
    for row in np.flatnonzero(found.count > 1):
        both = np.sort(np.concatenate([found.minima[row], found.maxima[row]]))
        is_minimum = np.isin(both[np.isfinite(both)], found.minima[row])
        assert (is_minimum[1:] != is_minimum[:-1]).all()


@pytest.fixture(scope="module")
def surfaces() -> list[tuple[np.ndarray, Surface]]:
    outlines = [outline(body(seed)) for seed in range(30)]
    return [(each, stable_surface(each)) for each in outlines]


def parts(surface: Surface, links: np.ndarray) -> np.ndarray:
    """Component of the surface that each point belongs to, joined by these links."""
    count = len(surface.psi)
    graph = coo_array((np.ones(len(links)), tuple(links.T)), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def test_the_surface_reaches_the_whole_outline_of_nearly_every_shape(surfaces):
    assert len(surfaces) == 30
    assert sum(surface.reach.all() for _, surface in surfaces) >= 27


def test_points_are_allowed_stable_poses(surfaces):
    for coefficients, surface in surfaces:
        at = height(coefficients, surface.phi1, surface.phi2, surface.psi)
        assert np.abs(at.slope).max() < 1e-12
        assert at.curvature.min() > 0
        readings = touch(coefficients, surface.phi1, surface.phi2, surface.psi)
        assert surface.s1 == pytest.approx(readings.s1, abs=1e-15)
        assert min(surface.s1.min(), surface.s2.min()) >= LIMITS.margin
        assert max(surface.s1.max(), surface.s2.max()) <= LIMITS.pad_length - LIMITS.margin
        assert (surface.phi1 + surface.phi2).max() < LIMITS.phi12_max


@pytest.mark.nightly
@pytest.mark.parametrize("number", [2, 5, 8])
def test_links_followed_in_small_steps_join_the_same_components(surfaces, number):
    """A link is judged by its two ends; nearly all are correct, and no wrong one joins separate components."""
    coefficients, surface = surfaces[number]
    a, b = surface.links.T
    at, now = basins(coefficients, surface.phi1[a], surface.phi2[a]), surface.psi[a, None]
    right = np.ones(len(a), dtype=bool)
    for share in np.linspace(0, 1, 13)[1:]:
        phi1, phi2 = (phi[a] + share * (phi[b] - phi[a]) for phi in (surface.phi1, surface.phi2))
        then = basins(coefficients, phi1, phi2)
        after = np.take_along_axis(then.minima, then.index(now), axis=1)
        right &= (at.index(after) == at.index(now))[:, 0]
        at, now = then, after
    right &= np.abs(nearest_turn(now[:, 0], surface.psi[b]) - surface.psi[b]) < 1e-9
    assert right.mean() > 0.998
    driven, joined = parts(surface, surface.links[right]), parts(surface, surface.links)
    pairs = {*zip(driven.tolist(), joined.tolist(), strict=True)}
    assert len(pairs) == driven.max() + 1 == joined.max() + 1


def test_a_narrow_neck_is_not_cut_by_the_grid():
    rng = np.random.default_rng(1)
    coefficients = [outline(random_body("nominal", rng)) for _ in range(7)][-1]
    for counts in ((60, 50), (120, 100)):
        surface = stable_surface(coefficients, phi1_count=counts[0], phi2_count=counts[1])
        assert np.bincount(parts(surface, surface.links)).max() > 0.99 * len(surface.psi)


def test_poses_from_the_closed_form_lie_on_the_surface(surfaces):
    """θ1 and φ2 alone determine the balance: λ = −d1/d2 = sin φ1 / sin φ12."""
    rng = np.random.default_rng(7)
    seen = 0
    for coefficients, surface in surfaces[:5]:
        theta1, phi2 = rng.uniform(0, 2 * np.pi, 400), rng.uniform(0.65, 2.65, 400)
        r1, d1, v1 = outline_at(coefficients, theta1)
        r2, d2, v2 = outline_at(coefficients, theta1 + phi2 - np.pi)
        ratio = -d1 / d2
        phi1 = np.arctan2(ratio * np.sin(phi2), 1 - ratio * np.cos(phi2))
        psi = phi1 - theta1 - np.pi / 2
        bend = (v1 - r1) + ratio * (v2 - r2)
        at = touch(coefficients, phi1, phi2, psi)
        inside = (ratio > 0) & (phi1 > 0.15) & (phi1 < 2.5) & (phi1 + phi2 < 2.9) & (bend > 4e-3)
        inside &= LIMITS.on_pads(at.s1 - 2e-3, at.s2 - 2e-3) & LIMITS.on_pads(at.s1 + 2e-3, at.s2 + 2e-3)
        for i in np.flatnonzero(inside):
            near = np.hypot(surface.phi1 - phi1[i], surface.phi2 - phi2[i]) < 0.08
            assert np.abs(nearest_turn(surface.psi[near], psi[i]) - psi[i]).min() < 0.3
            reach = surface.reach
            bin_ = int(theta1[i] / (2 * np.pi) * len(reach))
            assert reach[np.array([bin_ - 1, bin_, bin_ + 1]) % len(reach)].any()
            seen += 1
    assert seen > 150


def test_reach_equals_the_normals_that_the_component_sweeps():
    """A round object with an offset centre of mass: θ1 = φ1 + const, so the palms' limits determine the reach."""
    coefficients = np.array([0.02, 0.002, 0.0])
    limits = SurfaceLimits(phi1=(0.5, 0.9), phi2=(1.5, 1.9))
    surface = stable_surface(coefficients, limits, phi1_count=9, phi2_count=9, bins=360)
    reached = np.flatnonzero(surface.reach)
    psi = np.pi / 2
    ends = [0.5 - psi - np.pi / 2, 0.9 - psi - np.pi / 2, 2.0 - psi - 3 * np.pi / 2, 2.8 - psi - 3 * np.pi / 2]
    bins = np.floor(np.degrees(np.mod(ends, 2 * np.pi))).astype(int)
    assert set(reached) == set(range(bins[0], bins[1] + 1)) | set(range(bins[2], bins[3] + 1))
    assert len(inside_boundary(coefficients, limits, np.linspace(1.5, 1.9, 9))) == 0


def test_impossible_arguments_are_rejected():
    coefficients = outline(body(0))
    for phi1, phi2 in ((-0.1, 1.0), (1.0, 0.0), (1.5, 1.7), (math.nan, 1.0)):
        with pytest.raises(ValueError, match="palms hold an object only"):
            stable_poses(coefficients, phi1, phi2)
    circle = np.array([0.02])
    assert len(stable_poses(circle, 0.7, 1.5)) == 0
    with pytest.raises(ValueError, match="balances everywhere"):
        follow(circle, np.zeros(1), np.array([0.7, 0.8]), np.array([1.5, 1.5]))
    with pytest.raises(ValueError, match="no palm pose"):
        stable_surface(coefficients, SurfaceLimits(phi1=(2.0, 2.6), phi2=(1.5, 2.7)))
