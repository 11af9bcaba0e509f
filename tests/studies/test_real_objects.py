"""Bodies of everyday objects have their stated size, weight and convexity."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palmd.events import FloatArray
from palmd.rig.shapes import Body
from tools.studies.real_objects import REAL_OBJECTS, real_object
from tools.studies.sharp_shapes import hull_of_discs

THETA = np.linspace(0.0, math.tau, 7200, endpoint=False)


def _points(body: Body) -> FloatArray:
    h, h1 = body.support.sample(THETA), body.support.sample(THETA, 1)
    c, s = np.cos(THETA), np.sin(THETA)
    return np.stack([h * c - h1 * s, h * s + h1 * c])


@pytest.mark.parametrize("kind", sorted(REAL_OBJECTS))
def test_each_is_convex_closed_and_as_wide_as_stated(kind: str) -> None:
    true = real_object(kind, np.random.default_rng(3))
    support = true.body.support
    assert (support.sample(THETA) + support.sample(THETA, 2)).min() > 0.2e-3
    at = _points(true.body)
    assert np.linalg.norm(np.diff(at, axis=1, append=at[:, :1]), axis=0).sum() == pytest.approx(
        support.sample(THETA).mean() * math.tau, rel=1e-3
    )
    widths = support.sample(THETA) + support.sample(THETA + math.pi)
    if kind != "gear" and true.size_m:
        assert widths.min() == pytest.approx(min(true.size_m), abs=0.06e-3)  # a flat side bulges by 0.5 µm per mm


@pytest.mark.parametrize("kind", ["die", "coin", "L-profile"])
def test_a_weight_moves_the_centre_of_mass_and_changes_the_inertia(kind: str) -> None:
    plain, weighted = (real_object(kind, np.random.default_rng(4), off) for off in (0.0, 1e-3))
    difference = weighted.body.support.sample(THETA) - plain.body.support.sample(THETA)
    assert difference.max() == pytest.approx(1e-3, rel=1e-4)
    assert difference.mean() == pytest.approx(0.0, abs=1e-9)
    assert weighted.body.rho < plain.body.rho


def test_the_inertia_of_an_angle_profile_is_not_its_hulls() -> None:
    body = real_object("L-profile", np.random.default_rng(5)).body
    leg = max(body.support.sample(THETA) + body.support.sample(THETA + math.pi)) / math.sqrt(2.0)
    assert body.support.sample(THETA).min() > 0.0  # the centre of mass is inside the hull
    corner = _points(body)[:, int(np.argmin(np.abs(THETA - 1.25 * math.pi)))]
    assert np.hypot(*corner) > 0.25 * leg  # and nearer to the corner than the hull's centroid
    assert 0.3 * leg < body.rho < 0.45 * leg


def test_a_hull_of_unequal_discs_touches_each_of_them() -> None:
    discs = [((0.01, 0.0), 2e-3), ((-0.004, 0.012), 5e-3), ((-0.006, -0.01), 1e-3)]
    outline = hull_of_discs(discs)
    for theta in THETA[::40]:
        reach = max(x * math.cos(theta) + y * math.sin(theta) + r for (x, y), r in discs)
        assert outline.at(theta)[0] == pytest.approx(reach, abs=2e-5)  # a side is passed within 2 mrad
