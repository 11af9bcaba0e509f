"""Stable poses between arcs against the emulated plant, which does not use tangents, and against plain differences."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palmd.events import PalmMotion
from palmd.model.arcs import contacts_on_arcs
from palmd.model.shape import coefficients_of
from palmd.model.stable_on_arcs import on_arcs
from palmd.model.stable_poses import basins, touch
from palmd.model.stable_surface import SurfaceLimits, stable_surface
from palmd.rig.curved_plant import max_curvature_radius, stable_on_arcs
from palmd.rig.shapes import Body, random_body
from palmd.system.arcs import joints_of, tangents

CURVATURES = [(14.0, 11.5), (-9.0, -14.0), (15.0, 0.0), (-8.0, 12.0)]
SCAN = 360  # values of ψ searched for changes of sign
_HALVINGS, _SAME_M = 26, 1e-7  # to 1e-10 rad
TOUCHES = [(0.5, 1.7), (0.9, 1.5)]  # rad: β1 and the tangents' opening for a circle


def _body(seed: int, curvatures: tuple[float, float]) -> Body:
    random = np.random.default_rng(seed)
    while True:
        body = random_body("nominal", random)
        if max(curvatures) * max_curvature_radius(body) < 0.8:
            return body


def _outline(body: Body) -> np.ndarray:
    return coefficients_of(body.support.sample(np.arange(720) * math.tau / 720), 12)


def stable_poses_on_arcs(
    coefficients: np.ndarray, phi1: float, phi2: float, curvatures: tuple[float, float]
) -> np.ndarray:
    """All stable ψ of one palm pose (rad), ascending in [0, 2π): where d1 sin β2 + d2 sin β1 rises through zero.

    For outlines with κv below `MOST_LYING`; none where the palms would touch an object from below or behind the hinge.
    """

    def balance(psi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        palms = np.full(len(psi), phi1), np.full(len(psi), phi2)
        s = contacts_on_arcs(coefficients, *palms, psi, curvatures)
        beta1, opening = tangents(palms, s, curvatures)
        at = touch(coefficients, beta1, opening, psi)
        laid = on_arcs(at, beta1, opening, curvatures)
        with np.errstate(invalid="ignore"):
            held = (np.abs(s - np.stack([laid.s1, laid.s2])) < _SAME_M).all(axis=0)
            held &= (beta1 > 0) & (beta1 + opening < np.pi)
        return np.asarray(at.d1 * np.sin(beta1 + opening) + at.d2 * np.sin(beta1)), np.asarray(held)

    width = 2 * np.pi / SCAN
    low = np.arange(SCAN, dtype=np.float64) * width
    uphill = balance(low)[0] >= 0
    low = low[~uphill & np.roll(uphill, -1)]
    high = low + width
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        above = balance(middle)[0] >= 0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.sort(np.mod(low, 2 * np.pi)[balance(low)[1]])


@pytest.mark.parametrize("curvatures", CURVATURES)
def test_stable_poses_are_those_of_the_plant(curvatures: tuple[float, float]) -> None:
    for seed, touching in enumerate(TOUCHES):
        body = _body(seed, curvatures)
        palms = joints_of(body.support.at(0.0)[0], touching, curvatures)
        wanted = np.sort(stable_on_arcs(body, PalmMotion.at_rest(palms), curvatures))
        assert stable_poses_on_arcs(_outline(body), *palms, curvatures) == pytest.approx(wanted, abs=1e-5)


@pytest.mark.parametrize("curvatures", CURVATURES)
def test_the_centre_of_mass_rises_around_a_stable_pose(curvatures: tuple[float, float]) -> None:
    outline, step = _outline(_body(5, curvatures)), 1e-5
    beta1, opening = np.meshgrid(np.linspace(0.3, 1.4, 12), np.linspace(1.2, 1.7, 12))
    beta1, opening = beta1.ravel(), opening.ravel()
    extrema = basins(outline, beta1, opening)
    checked = 0
    for psi in (*extrema.minima.T, *extrema.maxima.T):
        some = np.isfinite(psi)
        contacts = touch(outline, beta1[some], opening[some], psi[some])
        laid = on_arcs(contacts, beta1[some], opening[some], curvatures)
        there = np.isfinite(laid.s1) & (np.abs(laid.s1) < 0.08) & (np.abs(laid.s2) < 0.08) & (laid.phi2 > 0.8)
        phi1, phi2, psi = laid.phi1[there], laid.phi2[there], psi[some][there]
        slopes = []
        for angle in (psi - step, psi, psi + step):
            s = contacts_on_arcs(outline, phi1, phi2, angle, curvatures)
            first, between = tangents((phi1, phi2), s, curvatures)
            at = touch(outline, first, between, angle)
            slopes.append(at.d1 * np.sin(first + between) + at.d2 * np.sin(first))
        assert slopes[1] == pytest.approx(np.zeros(len(psi)), abs=1e-10), "balance agrees with the tangents"
        assert s == pytest.approx(np.stack([laid.s1, laid.s2])[:, there], abs=1e-6)
        clear = np.abs(slopes[2] - slopes[0]) > 2e-9
        assert ((slopes[2] > slopes[0]) == laid.stable[there])[clear].all()
        checked += int(clear.sum())
    assert checked > 200


@pytest.mark.parametrize("curvatures", CURVATURES)
def test_the_surface_has_the_plants_poses_and_no_others(curvatures: tuple[float, float]) -> None:
    body = _body(2, curvatures)
    outline = _outline(body)
    limits = SurfaceLimits((0.02, 2.2), (0.9, 2.8), math.radians(165.0), curvatures=curvatures)
    surface = stable_surface(outline, limits, bins=72)
    assert len(surface.psi) > 500
    assert limits.on_pads(surface.s1, surface.s2).all()
    assert limits.hold(surface.phi1, surface.phi2).all()
    random = np.random.default_rng(1)
    for point in random.integers(0, len(surface.psi), 2):
        palms = float(surface.phi1[point]), float(surface.phi2[point])
        wanted = np.array(stable_on_arcs(body, PalmMotion.at_rest(palms), curvatures))
        assert np.abs(np.exp(1j * wanted) - np.exp(1j * surface.psi[point])).min() < 1e-4
    missing = tried = 0
    for _ in range(12):
        beta = random.uniform(0.4, 1.0), random.uniform(1.4, 1.8)
        palms = joints_of(outline[0], beta, curvatures)
        if not limits.hold(*map(np.asarray, palms)):
            continue
        for psi in stable_poses_on_arcs(outline, *palms, curvatures):
            s1, s2 = contacts_on_arcs(outline, *(np.array([each]) for each in (*palms, psi)), curvatures)
            if limits.on_pads(s1 - 2e-3, s2 - 2e-3) & limits.on_pads(s1 + 2e-3, s2 + 2e-3):
                near = np.hypot(surface.phi1 - palms[0], surface.phi2 - palms[1])
                near = np.hypot(near, np.angle(np.exp(1j * (surface.psi - psi))) / 4)
                tried, missing = tried + 1, missing + bool(near.min() > 0.12)
    assert tried > 10
    assert not missing


def test_an_object_too_round_for_the_palms_has_no_stable_pose() -> None:
    circle = np.zeros(15)
    circle[:2] = 0.02, 1e-3
    contacts = touch(circle, np.array([0.7]), np.array([1.7]), np.array([0.3]))
    assert not on_arcs(contacts, np.array([0.7]), np.array([1.7]), (48.0, 48.0)).stable.any()
