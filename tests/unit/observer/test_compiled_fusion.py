"""`model/fusion.c` against NumPy (`plain_shape_filters`): each routine, whole records, late events."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plain_shape_filters import PlainShapeFilters
from simulated import simulated

from palmd.events import PadLift, PadSample, PalmSample
from palmd.model import shape_map
from palmd.model.outputs import NAMED
from palmd.model.shape_map import Z
from palmd.model.smoothing import ORDER, RIG_CONSTANTS, R
from palmd.observer.bank import GATE, LOST_SCORE, Belief
from palmd.observer.bank_observer import BankObserver
from palmd.observer.compiled_fusion import CompiledPalms, Routines
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.fusion import PLAUSIBLE, Fusion
from palmd.observer.history import EVENTS
from palmd.observer.noise import map_as_noise
from palmd.observer.palms import FORGOTTEN_S, PalmTracker
from palmd.observer.prior import GYRATION, blind_start
from palmd.observer.rig_error import RigError
from palmd.system.description import ROUNDING_S, PadSensor, RigDescription

RIGS = {"flat": RigDescription(), "curved": RigDescription(pads=(PadSensor(curvature=4.0), PadSensor(curvature=-3.0)))}
ROUNDING = 1e-12


def pair(rig, size, order=shape_map.HARMONICS):
    """Two banks with the same filters of the same object, in C and in NumPy, and palms with three reports."""
    both = [ShapeFilters(rig, size, order=order), PlainShapeFilters(rig, size, order)]
    random = np.random.default_rng(5)
    off = 1e-4 * random.standard_normal(RIG_CONSTANTS)
    n = shape_map.size(order)
    means = np.zeros((both[0].bank.size, n))
    means[:, : Z.SHAPE] = 0.1 * random.standard_normal((len(means), Z.SHAPE))
    means[:, Z.LN_RHO], means[:, Z.LN_DITHER] = math.log(0.012), math.log(0.02)
    means[:, Z.MU], means[:, Z.DAMPING] = 0.1, 0.0
    means[:, Z.SHAPE :] = 3e-4 * random.standard_normal((len(means), n - Z.SHAPE))
    means[:, Z.SHAPE] = 0.02
    root = 1e-3 * random.standard_normal((len(means), n, n))
    for filters in both:
        filters.rig_error = RigError(tuple(pad.length for pad in rig.pads), rig.curvatures, off.copy())
        filters.bank.refill()
        filters.bank.x[:], filters.bank.P[:] = means, root @ root.transpose(0, 2, 1)
    palms = [filters.tracker(2e-4) for filters in both]
    for sample in (PalmSample(t, (0.8 + 0.3 * t, 1.6 - t * t), (0.3, -2 * t), (0.0, -2.0)) for t in (0.0, 0.016, 0.03)):
        for each in palms:
            each.feed(sample)
    return both, palms


def same(filters, tolerance=ROUNDING):
    """Check that both banks have the same state."""
    one, other = (each.bank for each in filters)
    assert one.size == other.size
    for name in ("x", "P", "score", "nis"):
        a, b = getattr(one, name), getattr(other, name)
        scale = np.abs(b[np.isfinite(b)]).max(initial=1e-300)
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance * scale, err_msg=name)


def reports(seed, plan_known):
    """Reports of palms, some late, repeated or forgotten; some with the plan's rates."""
    random = np.random.default_rng(seed)
    t = 0.0
    for _ in range(60):
        t += random.choice([0.016, 0.016, 0.016, 0.0, -0.01, 0.1, 1.2 * FORGOTTEN_S])
        plan = tuple(map(tuple, random.standard_normal((2, 2))))
        known = random.random() < {"always": 1.0, "often": 0.8, "never": 0.0}[plan_known]
        angles = (0.8 + 0.2 * math.sin(t), 1.6 + 0.1 * math.cos(2 * t))
        yield PalmSample(t, angles, *(plan if known else (None, None)))


@pytest.mark.parametrize("plan_known", ["always", "often", "never"])
def test_the_compiled_palm_motion_agrees_with_numpy(plan_known):
    compiled, twin = CompiledPalms(Routines(shape_map.library()), 2e-4), PalmTracker(2e-4)
    assert (compiled.known, compiled.t, compiled.repeated) == (twin.known, twin.t, twin.repeated)
    for sample in reports(1, plan_known):
        compiled.feed(replace(sample, angles=list(sample.angles)))  # as in another process
        twin.feed(sample)
        assert compiled.t == twin.t
        assert compiled.repeated == pytest.approx(twin.repeated, rel=ROUNDING)
        np.testing.assert_allclose(compiled.jerk, twin.jerk, rtol=ROUNDING)
        for t in (twin.t - 0.02, twin.t, twin.t + 0.03):
            np.testing.assert_allclose(compiled.at(t), twin.at(t), rtol=1e-10, atol=1e-11)
            for a, b in zip(compiled.sd(t), twin.sd(t), strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-9)


@pytest.mark.parametrize("kind", RIGS)
@pytest.mark.parametrize(("size", "order"), [(16, shape_map.HARMONICS), (1, ORDER)])
def test_compiled_prediction_and_updates_agree_with_numpy(kind, size, order):
    filters, palms = pair(RIGS[kind], size, order)
    for pad, until, force in ((1, 0.034, 1.3), (2, 0.0345, 0.8), (2, 0.051, None), (1, 0.051, 1.2)):
        for each, tracked in zip(filters, palms, strict=True):
            each.propagate(0.03, until, tracked, 1.7)
            each.fuse_pad(PadSample(until, pad, 0.021, force), 1e-6, tracked, 1.7)
        same(filters, 1e-10)


@pytest.mark.parametrize("kind", RIGS)
def test_compiled_event_sequences_agree_with_numpy(kind):
    filters, palms = pair(RIGS[kind], 1, ORDER)
    events = [
        PadSample(0.034, 1, 0.021, 2.3),
        PadLift(0.0345, 2),
        PalmSample(0.046, (0.811, 1.597), (0.29, -0.09), (0.1, -2.1)),
        PadSample(0.0465, 1, 0.0213, None),  # beyond the pad's scale
        PadSample(0.04, 2, 0.02, 0.9),  # earlier than the last reading
        PadSample(0.052, 2, 0.0202, 1.1),
        PalmSample(0.062, (0.815, 1.595)),
        PadSample(0.0655, 1, 0.0214, 1.4),
    ]
    results = []
    for each, tracked in zip(filters, palms, strict=True):
        each.rig_error.values[R.LAG : R.LAG + 2] = 2e-3, -1e-3
        results.append(each.fuse_events(events, 0.03, tracked, np.array([1e-6, 2e-6]), np.array([1.0, 70.0])))
    assert results[0] == results[1] == (pytest.approx(0.0635), 4)
    same(filters, 1e-9)
    np.testing.assert_allclose(palms[0].at(0.07), palms[1].at(0.07), rtol=1e-10)
    assert filters[0].fuse_events([PadLift(0.07, 1)], 0.07, palms[0], np.ones(2), np.ones(2)) == (0.07, 0)


def test_readings_that_share_an_error_of_place_determine_an_estimate_less():
    """A pad with 0.1 mm of smooth error, against one with as much noise of each reading."""
    smooth = map_as_noise(RigDescription().with_pads(map_sd=1e-4))
    independent = replace(smooth, pads=tuple(replace(pad, map_sd=0.0, map_noise=0.0) for pad in smooth.pads))
    left = []
    for rig in (smooth, independent):
        (filters, _), (palms, _) = pair(rig, 1, ORDER)
        filters.spread = np.zeros((filters.bank.n, RIG_CONSTANTS))
        predicted = filters.named(0, 0.03, 0.001, palms)[0][NAMED.index("s1")]
        fusion = Fusion(rig, [filters])
        fusion.use_single_filter(filters, filters.bank.x[0].copy(), filters.bank.P[0].copy(), 1.0)
        fusion.t = fusion.t_start = 0.03
        fusion.add_palm_report(PalmSample(0.03, (0.809, 1.5991), (0.3, -0.06), (0.0, -2.0)))
        fusion.add(PadSample(0.031, 1, predicted, 1.0))
        left.append(np.linalg.slogdet(filters.bank.P[0])[1])
    assert left[0] > left[1] + 0.1


@pytest.mark.parametrize("kind", RIGS)
@pytest.mark.parametrize("left_by", ["nobody", "spread", "provisional_spread"])
def test_compiled_published_values_and_variances_agree_with_numpy(kind, left_by):
    filters, palms = pair(RIGS[kind], 1, ORDER)
    random, shape = np.random.default_rng(2), (filters[0].bank.n + RIG_CONSTANTS, RIG_CONSTANTS)
    for steps in (1e-3 * random.standard_normal(shape), 1e-3 * random.standard_normal(shape)):
        results = []
        for each, tracked in zip(filters, palms, strict=True):
            if left_by != "nobody":
                setattr(each, left_by, steps)
            results.append(each.named(0, 0.03, 0.009, tracked))
        for got, wanted in zip(*results, strict=True):
            np.testing.assert_allclose(got, wanted, rtol=1e-10, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize("kind", RIGS)
@pytest.mark.parametrize("constant", [R.TILT, R.TURN, R.STANDOFF, R.STANDOFF + 1, R.SAGITTA, R.SAGITTA + 1])
def test_the_spread_of_a_rig_constant_equals_its_finite_difference(kind, constant):
    """The variance from a step of a constant and of the state with it, against applying the step."""
    filters, palms = pair(RIGS[kind], 1, ORDER)
    each, tracked = filters[0], palms[0]
    n, random = each.bank.n, np.random.default_rng(3)
    step = np.zeros((n + RIG_CONSTANTS, 1))
    step[[Z.PSI, Z.LN_RHO], 0], step[n + constant, 0] = 1e-5 * random.standard_normal(2), 1e-5
    each.spread, each.bank.P[:] = np.zeros_like(step), 0.0  # large covariances would leave no digits for the difference
    _, least = each.named(0, 0.03, 0.0, tracked)
    found, at = [], each.bank.x[0].copy()
    for side in (1.0, -1.0):
        each.bank.x[0] = at + side * step[:n, 0]
        each.rig_error.values[constant] += side * 1e-5
        found.append(each.named(0, 0.03, 0.0, tracked)[0])
        each.rig_error.values[constant] -= side * 1e-5
    each.bank.x[0], each.spread = at, step
    _, more = each.named(0, 0.03, 0.0, tracked)
    wanted = (np.subtract(*found) / 2) ** 2
    np.testing.assert_allclose(np.subtract(more, least), wanted, rtol=2e-3, atol=1e-5 * wanted.max())


def resting_circle(rig):
    filters = ShapeFilters(rig, 1)
    filters.bank.x[:, Z.SHAPE] = 0.02
    palms = filters.tracker(2e-4)
    palms.feed(PalmSample(0.0, (0.8, 1.6), (0.0, 0.0), (0.0, 0.0)))
    return filters, palms


def test_angle_uncertainty_counts_until_a_smoother_has_estimated_it():
    filters, palms = resting_circle(replace(RIGS["flat"], angle_sd=2e-3, gravity_sd=3e-3))
    angles = [NAMED.index(name) for name in ("phi1", "phi2")]
    before = np.array(filters.named(0, 0.0, 0.001, palms)[1])[angles]
    filters.spread = np.zeros((filters.bank.n + RIG_CONSTANTS, RIG_CONSTANTS))
    after = np.array(filters.named(0, 0.0, 0.001, palms)[1])[angles]
    assert before - after == pytest.approx([4e-6, 4e-6])
    assert after[0] - after[1] == pytest.approx(9e-6)


@pytest.mark.parametrize("one_gauge", [True, False])
@pytest.mark.parametrize("kind", RIGS)
def test_compiled_disagreement_of_hypotheses_agrees_with_numpy(kind, one_gauge):
    filters, palms = pair(RIGS[kind], 16)
    results = []
    for each, tracked in zip(filters, palms, strict=True):
        fusion = Fusion(RIGS[kind], [each])
        fusion.filters, fusion.palms, fusion.t = each, tracked, 0.03
        score = each.bank.score
        score[:] = np.linspace(-PLAUSIBLE - 3.0, 0.0, len(score))
        each.bank.x[3, Z.PSI] += 2.0 * math.tau - 0.2  # equivalent to 0.2 in the other direction, and not a rival
        each.bank.x[12, Z.PSI] += math.tau + 0.2
        results.append(fusion.disagreement(one_gauge))
        score[:-1] = -PLAUSIBLE  # at the limit
        assert fusion.disagreement(one_gauge) is None
    np.testing.assert_allclose(*results, rtol=1e-9, atol=1e-15)
    psi = results[0][NAMED.index("psi")]
    assert 0.05 < psi < 0.5 if one_gauge else psi == 0.0


def test_rounded_set_points_add_to_the_palms_variance():
    rounding = 1.5e-3
    variances = []
    for rig in (RIGS["flat"], replace(RIGS["flat"], goal_rounding=rounding)):
        filters, palms = resting_circle(rig)
        variances.append(filters.named(0, 0.0, 0.001, palms)[1])
    more = dict(zip(NAMED, np.subtract(variances[1], variances[0]), strict=True))
    angle = rounding**2 / 12
    assert more["phi1"] == pytest.approx(angle)
    assert more["phi2"] == pytest.approx(2 * angle)  # of both joints
    assert more["omega2"] == pytest.approx(2 * angle / ROUNDING_S**2)
    assert more["r1"] == 0.0


def test_compiled_forgetting_is_identical_to_numpy():
    filters, _ = pair(RIGS["flat"], 16)
    random = np.random.default_rng(3)
    shape = filters[0].bank.x.shape
    sds = random.uniform(0.1, 1.0, shape[1]), random.uniform(0.1, 1.0, shape)
    for sd in (sds[0], sds[1], sds[1], sds[0]):
        belief = Belief(slice(Z.LN_RHO, shape[1]), random.standard_normal(shape), sd)
        for each in filters:
            each.bank.fade(1, 0.3, belief)
    for name in ("x", "P"):
        np.testing.assert_array_equal(getattr(filters[0].bank, name), getattr(filters[1].bank, name))


def test_the_prior_is_that_of_the_last_start_and_each_filters_radius():
    (kept, _), (palms, _) = pair(RIGS["flat"], 16)
    for contacts in ((0.02, 0.021), (0.03, 0.031)):
        start = blind_start(contacts, palms.motion(0.0), 16, True, np.random.default_rng(1))
        kept.start(start, palms, 0.0)
        for radius in (0.02, np.linspace(0.01, 0.04, 16)):
            kept.bank.x[:, Z.SHAPE] = radius
            prior = kept.constants(start)
            ln_rho = math.log(GYRATION) + np.log(np.broadcast_to(radius, 16))
            np.testing.assert_allclose(prior.mean[:, Z.LN_RHO], ln_rho, rtol=1e-12)
            assert np.all(prior.mean[:, Z.SHAPE] == start.mean_radius)
            np.testing.assert_array_equal(prior.sd[Z.SHAPE :], start.shape_sd)


def test_compiled_convexity_constraint_agrees_with_numpy():
    filters, _ = pair(RIGS["flat"], 16)
    for each in filters:
        each.bank.x[3:9, Z.SHAPE + 6] = 0.02  # waves with negative v at some normals
        each.bank.x[10, Z.SHAPE + 6] = 40.0  # beyond the range of erfc
        each.bank.P[4] = 0.0  # exactly known, so that nothing can change
    below = [[each.bank.falls_below(member, each.curvature) for member in range(16)] for each in filters]
    assert below[0] == below[1]
    assert all(below[0][3:9])
    found = [[each.bank.impose_nonnegative(block, each.curvature) for block in range(2)] for each in filters]
    assert found[0] == found[1] == [False, False]
    same(filters, 1e-9)
    for each in filters:
        each.bank.x[:, Z.SHAPE + 1 :] = 0.0  # circles
        assert not each.bank.falls_below(1, each.curvature)
        assert each.bank.impose_nonnegative(0, each.curvature)


@pytest.mark.parametrize("lost", [[2, 9], list(range(16))])
def test_compiled_parking_of_nan_filters_agrees_with_numpy(lost):
    filters, palms = pair(RIGS["flat"], 16)
    for each, tracked in zip(filters, palms, strict=True):
        each.bank.x[lost, Z.PSI] = np.nan
        each.bank.score[:] = np.arange(16.0)
        each.fuse_pad(PadSample(0.03, 1, 0.021, 1.3), 1e-6, tracked, 1.0)
        assert np.all(each.bank.score[lost] == LOST_SCORE)
        assert np.isfinite(each.bank.x).all()
    same(filters)


def test_invalid_arguments_are_refused():
    filters, _ = pair(RIGS["flat"], 16)
    bank = filters[0].bank
    with pytest.raises(ValueError, match=r"\(16, 21\) at least, not \(8, 21\)"):
        bank.fade(0, 0.1, Belief(slice(2, 5), np.zeros((8, bank.n)), np.ones(bank.n)))
    with pytest.raises(ValueError, match="there is no pad 3"):
        filters[0].fuse_pad(PadSample(0.03, 3, 0.02, 1.0), 1e-8, filters[0].tracker(2e-4), 1.0)
    with pytest.raises(ValueError, match=r"21 columns, .* not \(3, 4\)"):
        bank.impose_nonnegative(0, np.ones((3, 4)))


# ---- whole records


def shuffled(events, seed=4):
    """Events as delivered by delayed connections: late, too late, repeated, with outliers between them."""
    random = np.random.default_rng(seed)
    arrivals = []
    for event in events:
        late = random.choice([0.0, 0.0, 0.0, 0.012, 0.03, 0.3])
        arrivals.append((event.t_sample + late, event))
        if random.random() < 0.02:
            arrivals.append((event.t_sample + 0.05, event))
        if isinstance(event, PadSample) and random.random() < 0.02:
            arrivals.append((event.t_sample + 0.001, replace(event, s=event.s + random.choice([0.004, 0.5, math.nan]))))
    return [event for _, event in sorted(arrivals, key=lambda each: each[0])]


def watched(filters, rig, events):
    """The observer's estimates every 10 ms, and the number of dropped events."""
    watcher, estimates, tick = BankObserver(filters, rig), [], 0.0
    for event in events:
        while tick + 0.05 < event.t_sample:
            tick += 0.01
            estimates.append(watcher.estimate(tick))
        watcher.feed(event)
    return watcher, estimates


@pytest.mark.parametrize("seed", [101, 102])
def test_estimates_of_a_whole_record_agree_with_numpy(seed):
    run = simulated("rig", seed, 4.0)
    events = shuffled(run.events)
    kinds = ShapeFilters, PlainShapeFilters
    (one, compiled_estimates), (other, wanted) = (watched(kind(run.rig, 32), run.rig, events) for kind in kinds)
    assert one.late_dropped == other.late_dropped > 10
    assert one.object_count == other.object_count
    for a, b in zip(compiled_estimates, wanted, strict=True):
        assert (a.valid, a.object_count) == (b.valid, b.object_count)
        for name in ("r1", "r2", "omega0", "rho", "mu", "nis", "mass"):
            x, y = getattr(a, name), getattr(b, name)
            assert x == pytest.approx(y, rel=1e-6, abs=1e-9, nan_ok=True), (a.t, name)
        assert a.sd["r1"] == pytest.approx(b.sd["r1"], rel=1e-6, nan_ok=True)


def test_readings_of_resting_palms_weigh_less_while_they_are_predicted():
    run = simulated("rig", 101, 2.5, rests=((0.8, 2.5),))
    both = [BankObserver(kind(run.rig, 8), run.rig) for kind in (ShapeFilters, PlainShapeFilters)]
    for event in run.events:
        for watcher in both:
            watcher.feed(event)
    compiled, twin = (watcher._fusion for watcher in both)
    shared = compiled.history.now.repeated
    assert shared == pytest.approx(twin.palms.repeated, abs=0.02), "except for the palms' last report"
    assert shared > 1.5
    same([compiled.filters, twin.filters], 1e-6)
    compiled.bank.nis[:] = 2.0
    compiled.add(PadSample(compiled.t + 0.005, 1, 0.02, 1.0))
    assert compiled.history.now.repeated == 1.0, "the object was moved"


def test_late_events_give_the_same_result_as_on_time():
    run = simulated("rig", 103, 1.0)
    last = max(i for i, event in enumerate(run.events) if isinstance(event, PalmSample) and event.t_sample < 0.9)
    after = [event for event in run.events[last:] if isinstance(event, PadSample)][:12]
    states = []
    for order in (after, after[::-1], [*after[6:], *after[:6]]):
        filters = ShapeFilters(run.rig, 8)
        watcher = BankObserver(filters, run.rig)
        for event in (*run.events[: last + 1], *order):
            watcher.feed(event)
        assert watcher.late_dropped == 0
        states.append(
            (filters.bank.x.copy(), filters.bank.P.copy(), filters.bank.score.copy(), filters.bank.nis.copy())
        )
    for state in states[1:]:
        for got, wanted in zip(state, states[0], strict=True):
            np.testing.assert_array_equal(got, wanted)


def test_the_number_of_events_that_can_be_undone_is_limited():
    run = simulated("rig", 103, 1.0)
    pads = [event for event in run.events if isinstance(event, PadSample)]
    for back, dropped in ((EVENTS, 0), (EVENTS + 1, 1)):
        watcher = BankObserver(ShapeFilters(run.rig, 8), run.rig)
        for event in run.events:
            if event is not pads[-1 - back]:
                watcher.feed(event)
        watcher.feed(pads[-1 - back])
        assert watcher.late_dropped == dropped


def test_an_outlier_counts_in_the_nis_as_one_at_the_gate():
    filters, palms = pair(RIGS["flat"], 8)
    for each, tracked in zip(filters, palms, strict=True):
        each.fuse_pad(PadSample(0.03, 1, 0.5, 1.0), 1e-12, tracked, 1.0)
        assert each.bank.nis.max() == 1.0 + (GATE - 1.0) / 50.0
