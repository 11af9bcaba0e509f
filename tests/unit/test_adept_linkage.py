"""The load of an Adept's gripper, checked by virtual work, for which no force has to be known."""

import math
from pathlib import Path

import numpy as np
import pytest

from palmd.yamlfile import load_config
from tools.adept.linkage import PALM_KG, drawing, grip, poses, worst

CONFIG = load_config(Path(__file__).parents[2] / "config/palmd.yaml")
RADIUS_MM, MASS_KG = 22.0, 0.2
G = 9.81


def places(phi1, phi12):
    """E, and the heights of the object and of both palms' centres (m)."""
    length1, length2 = (1e-3 * length for length in CONFIG.rig.palm_lengths_mm)
    first, second, middle = (
        np.array([math.cos(a), math.sin(a)]) for a in (phi1, phi12, 0.5 * (phi1 + phi12))
    )  # fmt: skip
    hinge = -length1 * first
    body = hinge + 1e-3 * RADIUS_MM / math.sin(0.5 * (phi12 - phi1)) * middle
    heights = (
        MASS_KG * body[1] + PALM_KG * (hinge + 0.5 * length1 * first)[1] + PALM_KG * (hinge + 0.5 * length2 * second)[1]
    )
    return hinge + length2 * second, G * heights


def work(pose, which):
    """Work of the weights, and motion and rotation of E, per radian of palm 1's or palm 2's direction."""
    phi1, phi12 = math.radians(pose[0]), math.radians(sum(pose))
    step = np.array([1e-6, 0.0] if which == 0 else [0.0, 1e-6])
    (after, gain), (before, loss) = (places(*(np.array([phi1, phi12]) + sign * step)) for sign in (1, -1))
    return (gain - loss) / 2e-6, (after - before) / 2e-6, float(which == 1)


@pytest.mark.parametrize("pose", [(45.0, 90.0), (20.0, 120.0), (70.0, 60.0), (110.0, 50.0)])
def test_force_and_moment_do_the_work_of_lifting(pose):
    found = grip(CONFIG.rig, pose, RADIUS_MM, MASS_KG, PALM_KG)
    gains, ways, turns = zip(*(work(pose, which) for which in (0, 1)), strict=True)
    for gain, way, turn in zip(gains, ways, turns, strict=True):
        assert found.force @ way + found.moment_nm * turn == pytest.approx(gain, abs=1e-6)


def test_the_drawing_shows_the_worst_case():
    force, moment = worst(CONFIG)
    assert f"{force.force_n:.1f} N" in drawing(CONFIG)
    assert f"{abs(moment.moment_nm):.2f} N·m" in drawing(CONFIG)
    assert force.angles_deg in set(poses(CONFIG.limits, 24.0))
