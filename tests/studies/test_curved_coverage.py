"""How much more of an outline curved palms touch: two curvatures, and what is counted."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tools.studies.curved_coverage import AMPLITUDES, Covered, by_motion, by_swing, covered, objects, table


def _rows(curvature: float, touched: list[float], kept: list[bool]) -> Covered:
    """One pose of each of some objects; the normals swing as far as the palms do, and what is touched rises with it."""
    n, every = len(touched), np.ones((1, len(AMPLITUDES)))
    grows = np.array(touched)[:, None] * AMPLITUDES / AMPLITUDES[-1]
    swing = np.tile(AMPLITUDES, (n, 1))
    return Covered(curvature, np.arange(n), grows, swing, np.array(kept)[:, None] & (every > 0), np.full(n, 0.9))


def test_what_lost_a_contact_has_no_say_in_what_is_touched_and_is_left_out_beside_it() -> None:
    flat, cradle = _rows(0.0, [0.4, 0.8], [True, True]), _rows(10.0, [0.6, 0.1], [True, False])
    for share in (by_motion(cradle, flat, 0.6), by_swing(cradle, flat, 0.6)):
        assert share.touched == pytest.approx(0.6)
        assert share.on_flat == pytest.approx(0.4), "of the object that both kept"
        assert share.kept == 0.5
    assert by_motion(flat, flat, 0.3).touched == pytest.approx(0.3)
    assert by_swing(flat, flat, 0.325).touched == pytest.approx(0.325, abs=1e-12), "between two amplitudes"
    assert math.isnan(by_swing(flat, flat, 0.7).touched), "so far it never swung"


def test_a_cradle_touches_more_than_flat_palms_and_a_dome_less_by_the_same_motion() -> None:
    bodies = objects(2, 3)
    rows = [covered(kappa, bodies) for kappa in (11.0, 0.0, -11.0)]
    cradle, flat, dome = rows
    assert by_motion(cradle, flat, 0.25).touched > 1.1 * by_motion(flat, flat, 0.25).touched
    assert by_motion(dome, flat, 0.25).touched < 0.95 * by_motion(flat, flat, 0.25).touched
    assert cradle.swing[:, 4].mean() > flat.swing[:, 4].mean()
    told = table(rows)
    assert "cradle R 91 mm" in told
    assert "dome R 91 mm" in told


def test_an_object_that_lies_in_the_palms_has_lost_its_contact() -> None:
    outline, rho = objects(1, 0)[0]
    row = covered(60.0, [(outline, rho)])
    assert not row.kept.any()
    assert np.isnan(row.reach).all()
