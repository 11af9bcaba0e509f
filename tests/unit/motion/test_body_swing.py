"""Moves for a body of which nothing is known yet."""

import numpy as np
import pytest
from body_stand import WIDE

from palmd.config.three_palms import ThreePalmsLimitsConfig
from palmd.motion.body_swing import FARTHEST_RAD, SWING_RAD, Swing
from palmd.motion.three_palms import TiltLimits


@pytest.mark.parametrize("wide", [True, False], ids=["wide", "narrow"])
def test_swings_go_around_the_middle_within_the_limits(wide):
    limits = TiltLimits.over(WIDE if wide else ThreePalmsLimitsConfig(beta_deg=(40.0, 60.0)), 75.0)
    swing, random = Swing(limits), np.random.default_rng(3)
    here, ends = swing.middle, []
    for _ in range(100):
        move = swing.next(here, random)
        assert move.start == here
        values = [limits.values(move.at(t)) for t in np.linspace(0.0, move.duration, 20)]
        assert all(bound.problem(v, v) is None for row in values for bound, v in zip(limits.bounds, row, strict=True))
        here = move.end
        ends.append(here)
    off = np.array(ends) - swing.middle
    assert np.abs(off).max() <= SWING_RAD + 1e-12
    assert np.linalg.matrix_rank(off, tol=0.1) == 3
    assert np.abs(np.diff(off, axis=0)).max(axis=1).min() > 0.02  # it never stands still


def test_from_far_away_it_returns_slowly_to_the_middle():
    limits = TiltLimits.over(WIDE, 75.0)
    swing = Swing(limits)
    far = tuple(low + 0.01 for low, _ in limits.angles)
    move = swing.next(far, np.random.default_rng(0))
    assert move.end == swing.middle
    way = max(abs(b - a) for a, b in zip(far, move.end, strict=True))
    assert way > FARTHEST_RAD
    assert move.duration > 2.0 * way / limits.rate
