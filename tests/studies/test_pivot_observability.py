"""What a pivoting grasp's readings tell: gradients against plain differences, and what the study says of sweeps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from palmd.model.pivot import P, U
from tools.studies import pivot_observability as study
from tools.studies.pivot_observability import SWEEPS, Y, bodies, mass_null, told

BODY = bodies(1, 0)[0]
BY_NAME = {sweep.name: sweep for sweep in SWEEPS}


def test_the_gradients_follow_the_motion_that_the_height_enforces() -> None:
    """Against heights solved anew for an outline that is a little different."""
    sweep = replace(BY_NAME["both sides"], sides=(1.0,))
    psi, u = study._motion(BODY, sweep)
    p, step = BODY.constants, 1e-7
    by_s, by_force = study._weighed(p, psi, u)
    inner = slice(3, -3)
    for coefficient in (0, 1, 4, 9):
        readings, forces = [], []
        for sign in (1.0, -1.0):
            moved = p.copy()
            moved[P.SHAPE + coefficient] += sign * step
            theta = study._at_height(moved[study._SHAPE], BODY, 1.0, u[:, U.Z])
            motion, _ = study._turning(moved[study._SHAPE], -0.5 * math.pi - theta, u)
            readings.append(study._kernel("reading", motion, moved, u)[0])
            forces.append(study._kernel("rigid_force", motion, moved, u)[0])
            turned = np.gradient(np.unwrap(motion[:, 0]), study.READING_S)
            assert motion[inner, 1] == pytest.approx(turned[inner], abs=2e-3), "it does turn like that"
        theta = -0.5 * math.pi - psi
        bend, e = (study._derivative(p[study._SHAPE], theta, order) for order in (2, 1))
        s_sd = np.hypot(study.READING_SD_M, bend / e * study.HEIGHT_SD_M)
        force_sd = np.hypot(study.FORCE_SHARE_SD * forces[0], study.FORCE_SD_N)
        for (plus, minus), rows, sd in ((readings, by_s, s_sd), (forces, by_force, force_sd)):
            wanted, own = (plus - minus) / (2 * step), rows[:, Y.SHAPE + coefficient] * sd
            assert own == pytest.approx(wanted, abs=1e-3 * np.abs(wanted).max())


def test_a_common_rotation_is_told_by_nothing() -> None:
    sweep = BY_NAME["both sides"]
    p = BODY.constants
    rotation = np.zeros(len(study._believed(p)))
    mx, my = p[P.MOMENT : P.MOMENT + 2]
    rotation[Y.MOMENT : Y.DAMPING] = -my, mx
    k = np.arange(1, study.ORDER + 1)
    cos, sin = p[P.SHAPE + 1 :: 2], p[P.SHAPE + 2 :: 2]
    rotation[Y.SHAPE + 1 :: 2], rotation[Y.SHAPE + 2 :: 2] = -k * sin, k * cos
    for rows in study._weighed(p, *study._motion(BODY, sweep)):
        assert np.abs(rows @ rotation).max() < 1e-9 * np.abs(rows * np.abs(rotation)).max()


def test_a_height_that_is_held_tells_one_thing_and_force_joins_the_sides() -> None:
    held, one, both = (told(BODY, BY_NAME[name]) for name in ("height held", "one side", "both sides"))
    assert held.rank == 1
    assert both.rank == both.of == 20
    assert one.touched < both.touched
    assert both.h_by_s > 5 * both.h, "without force each side has a rotation of its own"
    assert one.h_by_s < 2 * one.h


def test_the_mass_is_told_by_no_force() -> None:
    least, direction = mass_null(BODY, BY_NAME["both sides"])
    assert least < 1e-12
    assert direction == pytest.approx([1.0, -1.0, -1.0, -1.0])
