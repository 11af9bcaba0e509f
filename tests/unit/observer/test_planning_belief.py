"""The belief for planning: the likeliest state, samples, and touched normals."""

import numpy as np
import pytest
from simulated import simulated

from palmd import observer
from palmd.model import shape_map
from palmd.model.shape import basis
from palmd.model.smoothing import RIG_CONSTANTS
from palmd.observer.filters.base import Overconfidence


def fed(seconds=4.5, overconfidence=None):
    """A shape observer after this time of the same run, and the time; its filters may be made less confident."""
    run = simulated("nominal", 2, 5.0)
    mine = observer.make("shape", run.rig)
    if overconfidence is not None:
        mine._fusion.filters.overconfidence = overconfidence
    t = run.events[0].t_sample
    for event in run.events:
        if event.t_sample > run.events[0].t_sample + seconds:
            break
        mine.feed(event)
        if event.t_sample > t + 0.01:
            t = event.t_sample
            mine.estimate(t)
    return mine, t


@pytest.fixture(scope="module")
def plain():
    return fed()


def test_the_first_state_is_that_of_the_estimate(plain):
    mine, t = plain
    belief, estimate, outline = mine.planning_belief(t), mine.estimate(t), mine.shape(t)
    assert estimate.valid
    state = belief.states[0]
    assert np.exp(state[shape_map.Z.LN_RHO]) == pytest.approx(estimate.rho)
    np.testing.assert_allclose(basis(outline.theta, 7) @ state[shape_map.Z.SHAPE :], outline.h)
    assert (belief.t, belief.object_count) == (t, estimate.object_count)
    assert (belief.touched.shape, belief.h_sd.shape) == ((72,), (72,))
    assert belief.touched.mean() == pytest.approx(estimate.touched)
    assert abs(belief.mass - simulated("nominal", 2, 5.0).truth.mass) < 3.0 * belief.mass_sd


def test_without_an_estimate_there_is_no_belief():
    assert observer.make("shape", simulated("nominal", 2, 5.0).rig).planning_belief(0.0) is None
    for name in ("extended", "quasistatic"):
        assert observer.make(name, simulated("nominal", 2, 5.0).rig).planning_belief(0.0) is None


def test_asking_for_a_belief_does_not_change_the_estimate(plain):
    mine, t = plain
    before = mine.estimate(t)
    for _ in range(3):
        mine.planning_belief(t)
    assert mine.estimate(t) == before


def test_samples_have_the_spread_of_the_published_error_bars():
    """A young filter is overconfident, so that samples and sds are inflated."""
    (sure, t), (doubtful, _) = (
        fed(overconfidence=Overconfidence(0.0, 1.0)),
        fed(overconfidence=Overconfidence(2.0, 1e9)),
    )
    one, other = sure.planning_belief(t), doubtful.planning_belief(t)
    np.testing.assert_array_equal(one.states[0], other.states[0])
    drawn = slice(-3, None)
    away, farther = one.states[drawn] - one.states[0], other.states[drawn] - other.states[0]
    keeps_sign = [i for i in range(shape_map.N) if i not in (shape_map.Z.MU, shape_map.Z.DAMPING)]
    np.testing.assert_allclose(farther[:, keeps_sign], 3.0 * away[:, keeps_sign], rtol=1e-6)
    np.testing.assert_allclose(other.h_sd, 3.0 * one.h_sd)


def test_the_rigs_spread_is_included_once_a_smoother_has_confirmed_it():
    mine, t = fed()
    assert mine.planning_belief(t).rig_spread is None
    filters = mine._fusion.filters
    spread = np.random.default_rng(1).standard_normal((filters.bank.n + RIG_CONSTANTS, RIG_CONSTANTS))
    _, before = filters.outline(0)
    filters.spread = spread
    np.testing.assert_array_equal(mine.planning_belief(t).rig_spread, spread[shape_map.Z.SHAPE :])
    of_outline = spread[shape_map.Z.SHAPE : filters.bank.n]
    np.testing.assert_allclose(filters.outline(0)[1], before + of_outline @ of_outline.T)


def test_a_provisional_rig_spread_is_in_the_band_only_and_ends_with_the_object():
    mine, t = fed()
    filters = mine._fusion.filters
    _, before = filters.outline(0)
    filters.provisional_spread = np.zeros((filters.bank.n + RIG_CONSTANTS, RIG_CONSTANTS))
    filters.provisional_spread[shape_map.Z.SHAPE, 0] = 3e-4  # of the mean radius
    assert mine.planning_belief(t).rig_spread is None
    np.testing.assert_allclose(
        filters.outline(0)[1] - before, np.diag([3e-4**2, *[0.0] * (len(before) - 1)]), atol=1e-12
    )
    assert mine.shape(t).h_sd.min() > 1e-4
    mine.reset()
    for event in simulated("nominal", 2, 5.0).events[:20]:
        mine.feed(event)
    assert mine.object_count == 1
    assert filters.provisional_spread is None
