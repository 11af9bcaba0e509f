"""Objects whose readings cannot tell their poses apart."""

import math

import numpy as np
import pytest

from palmd.events import PalmMotion
from palmd.model.stable_poses import (
    centre_of_mass,
    centre_of_rotation,
    follow,
    height,
    nearest_turn,
    outline_at,
    stable_poses,
    touch,
)
from palmd.rig import plant
from palmd.rig.shapes import Body, Support
from tools.studies.equations.ambiguous import ambiguous_outline, many_poses

SQUARE = math.pi / 2


def body(coefficients: np.ndarray) -> Body:
    z = [complex(coefficients[0]), *(complex(a, -b) for a, b in coefficients[1:].reshape(-1, 2))]
    return Body("ambiguous", Support.from_coefficients(tuple(z)), 0.014, 0.1)


@pytest.mark.parametrize("count", range(2, 13))
def test_many_stable_poses_with_equal_readings_of_a_convex_object(count):
    found = many_poses(count)
    palms = np.asarray(found.phi1), np.asarray(found.phi2)
    at, y = touch(found.coefficients, *palms, found.psi), height(found.coefficients, *palms, found.psi)
    assert len(found.psi) == count
    assert at.s1 == pytest.approx(found.s1, abs=1e-12)
    assert at.s2 == pytest.approx(found.s2, abs=1e-12)
    assert np.abs(y.slope).max() < 1e-12
    assert y.curvature.min() > 0.39 * found.coefficients[0]
    assert centre_of_mass(at, palms[0])[:, 1] == pytest.approx(found.height, abs=1e-12)
    assert outline_at(found.coefficients, np.linspace(0, 2 * np.pi, 7201))[2].min() > 0.05 * found.coefficients[0]
    everything = stable_poses(found.coefficients, found.phi1, found.phi2)
    off = [np.abs(nearest_turn(everything, psi) - psi).min() for psi in found.psi]
    assert off == pytest.approx([0] * count, abs=1e-9)
    if count > 2:
        assert np.ptp(found.height) > 1e-4  # the poses are different, not one shape turned


@pytest.mark.parametrize("count", [2, 5])
def test_the_plant_reads_the_same_and_stays(count):
    found = many_poses(count)
    palms = PalmMotion.at_rest((found.phi1, found.phi2))
    rig = plant.Plant(
        body(found.coefficients), plant.Hinge("fixed", base=(0.0, 0.0)), plant.FrictionSurface(damping=2e-3)
    )
    for psi in found.psi:
        rig.place(palms, psi + 0.03)
        for _ in range(4000):
            rig.advance(palms, palms, 5e-4)
        assert rig.state.psi == pytest.approx(psi, abs=1e-4)
        assert [contact.s for contact in rig.contacts()] == pytest.approx([found.s1, found.s2], abs=1e-5)


def test_motion_tells_three_poses_apart():
    found = many_poses(3)
    turn = np.linspace(0, np.radians(5), 6)
    path1, path2 = found.phi1 + turn, np.full(6, found.phi2)
    followed = follow(found.coefficients, found.psi, path1, path2)
    assert not followed.jumped.any()
    at = touch(found.coefficients, path1[-1], path2[-1], followed.psi[-1])
    apart = np.hypot(np.subtract.outer(at.s1, at.s1), np.subtract.outer(at.s2, at.s2))
    assert apart[np.triu_indices(3, 1)].min() > 1e-4  # a pad's noise


def test_readings_need_not_be_equal_on_both_palms():
    """On palms that are not symmetric about gravity, with poses that are not evenly turned."""
    phi1, phi2, s1, s2 = (np.asarray(value) for value in (0.65, 2.0, 0.013, 0.015))
    psi = np.array([0.3, 2.3, 4.5])
    level = centre_of_rotation(s1, s2, phi1, phi2)[1] + np.array([0.0, 4e-4, -3e-4])
    found = ambiguous_outline(float(phi1), float(phi2), float(s1), float(s2), psi, level)
    at = touch(found.coefficients, phi1, phi2, psi)
    assert at.s1 == pytest.approx(float(s1), abs=1e-12)
    assert at.s2 == pytest.approx(float(s2), abs=1e-12)
    assert centre_of_mass(at, phi1)[:, 1] == pytest.approx(level, abs=1e-12)
    assert height(found.coefficients, phi1, phi2, psi).curvature.min() > 0


def test_what_no_convex_outline_does_is_refused():
    level = 0.02 * math.sqrt(2)
    palms = (SQUARE / 2, SQUARE, 0.02, 0.02)
    with pytest.raises(ValueError, match="no convex outline"):
        ambiguous_outline(*palms, np.array([0.0, 0.9, 2.6]), level + np.array([4e-3, -4e-3, 4e-3]))
    # a quarter turn puts on palm 2 the normal that was on palm 1
    with pytest.raises(ValueError, match="touch with the same normal"):
        ambiguous_outline(*palms, np.array([0.0, SQUARE]), level + np.array([0.0, 1e-3]))
