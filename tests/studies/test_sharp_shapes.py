"""Bodies with corners, flat sides and chords are closed and convex, with the length and inertia of their geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palmd.events import PalmMotion
from palmd.rig.plant import FrictionSurface, Hinge, Plant
from palmd.rig.shapes import Support
from tools.studies.sharp_shapes import ArcSupport, ChordSupport, rounded_polygon, uniform_body

SQUARE = [(9e-3, 9e-3), (-9e-3, 9e-3), (-9e-3, -9e-3), (9e-3, -9e-3)]
CIRCLE = Support.from_coefficients((0.02 + 0j,))
THETA = np.linspace(-4.0, 9.0, 4001)


def _outlines() -> list[ArcSupport | ChordSupport]:
    return [
        rounded_polygon(SQUARE, 1e-3),
        rounded_polygon([(0.02, 0.0), (0.0, 0.015), (-0.012, -0.01)], 3e-3),
        ChordSupport(CIRCLE, 1.3, 10e-3, 2e-3),
    ]


@pytest.mark.parametrize("outline", _outlines())
def test_h_and_its_slope_are_one_smooth_function_around_the_outline(outline: ArcSupport | ChordSupport) -> None:
    step = 1e-7
    for theta in THETA:
        low, (h, slope, _), high = (outline.at(theta + each)[:3] for each in (-step, 0.0, step))
        assert (high[0] - low[0]) / (2 * step) == pytest.approx(slope, abs=2e-6)
        again = outline.at(theta + math.tau)
        assert again[:2] == pytest.approx((h, slope), abs=1e-12)


@pytest.mark.parametrize("outline", _outlines())
def test_no_curvature_radius_is_negative(outline: ArcSupport | ChordSupport) -> None:
    assert min(h + h2 for h, _, h2 in (outline.at(theta) for theta in THETA)) > 0.9e-3


@pytest.mark.parametrize("outline", _outlines())
def test_a_rotated_outline_is_touched_at_rotated_normals(outline: ArcSupport | ChordSupport) -> None:
    turned = outline.turned(0.7)
    for theta in THETA[::50]:
        assert turned.at(theta + 0.7)[:2] == pytest.approx(outline.at(theta)[:2], abs=1e-12)


def test_the_hull_of_discs_touches_each_of_them() -> None:
    outline = rounded_polygon(SQUARE, 1e-3)
    for theta in THETA:
        reach = max(x * math.cos(theta) + y * math.sin(theta) for x, y in SQUARE) + 1e-3
        assert outline.at(theta)[0] == pytest.approx(reach, abs=1e-5)  # a side is passed within 2 mrad


def test_a_contact_crosses_the_whole_chord_within_a_small_rotation() -> None:
    outline = ChordSupport(CIRCLE, 1.3, 10e-3, 2e-3)
    before, after = outline.at(1.299)[1], outline.at(1.301)[1]
    assert after - before == pytest.approx(10e-3, rel=0.01)


def test_a_square_has_the_inertia_and_mass_of_a_square() -> None:
    body = uniform_body("square", rounded_polygon(SQUARE, 1e-6), 0.1, com=(1e-3, 0.0))
    assert body.rho == pytest.approx(18e-3 / math.sqrt(6.0), rel=1e-3)
    assert body.support.at(0.0)[0] == pytest.approx(8e-3, abs=1e-5)
    assert body.support.at(math.pi)[0] == pytest.approx(10e-3, abs=1e-5)


@pytest.mark.parametrize("outline", _outlines())
def test_the_free_rotation_ends_where_the_outline_jumps(outline: ArcSupport | ChordSupport) -> None:
    room = np.array([outline.room(theta) for theta in THETA])
    assert room.min() > 1e-5
    assert room.max() < 2.0
    for theta, turn in zip(THETA, room, strict=True):
        here, there = (sum(outline.at(each)[::2]) for each in (theta, theta + turn))
        assert there < here + 0.05 or turn < 2e-3 * 0.3  # on a flat side v is 5 m and more


def test_friction_only_dissipates_energy_of_a_rocking_block() -> None:
    body = uniform_body("block", rounded_polygon([(4.5e-3, -14.5e-3), (4.5e-3, 14.5e-3), (-4.5e-3, 14.5e-3),
                                                  (-4.5e-3, -14.5e-3)], 5e-4), 0.1)  # fmt: skip
    palms = PalmMotion.at_rest((0.7, 1.4))
    plant = Plant(body, Hinge("fixed"), FrictionSurface(0.2, 8e-3))
    plant.place(palms, psi=1.0)
    energies = [plant.energy()]
    for _ in range(500):
        plant.advance(palms, palms, 5e-4)
        energies.append(plant.energy())
    assert not plant.fallen
    assert np.diff(energies).max() < 9.81 * 1e-4  # m²/s²
    assert energies[-1] < energies[0] - 9.81 * 1e-3
