"""Which normals of an outline the palms can touch; a circle, which rests anywhere, has no stable poses."""

import numpy as np

from palmd.model.stable_surface import SurfaceLimits, stable_surface
from palmd.motion.reach import reach

CIRCLE = np.array([0.02] + [0.0] * 14)
LIMITS = SurfaceLimits()


def test_a_circle_has_no_surface_of_stable_poses():
    surface = stable_surface(CIRCLE, LIMITS, bins=72)
    assert not surface.reach.any()
    assert len(surface.psi) == len(surface.links) == 0


def test_a_circles_whole_outline_is_reachable():
    oval = CIRCLE.copy()
    oval[3] = 1e-6
    assert reach(CIRCLE, LIMITS).all()
    assert (reach(CIRCLE, LIMITS) == reach(oval, LIMITS)).all()


def test_a_circle_that_leaves_the_pads_is_not_reachable():
    assert not reach(50.0 * CIRCLE, LIMITS).any()
