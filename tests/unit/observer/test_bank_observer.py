"""The bank observer on simulated runs: blind start, lifts, gaps, outliers and objects that return."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from campaign import nightly
from palms import palm_sample
from simulated import simulated, watched

from palmd import observer
from palmd.events import Estimate, Event, PadLift, PadSample, PalmSample
from palmd.model import building, compiled, extended
from palmd.model import shape as modelled
from palmd.observer.bank_observer import BankObserver
from palmd.observer.coverage import NORMAL_BINS
from palmd.observer.filters.extended import ExtendedFilters
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.palms import PalmTracker
from palmd.observer.prior import blind_start
from palmd.rig.simulate import simulate_log
from palmd.system.description import PadSensor, RigDescription


def _run(kind: str, seed: int, duration_s: float) -> tuple[RigDescription, list[Event], dict]:
    lines, truth = simulate_log(kind, seed, duration_s)
    hinge = lines[0]["rig"]["hinge"]
    rig = RigDescription(hinge=hinge["mode"], palm1_length=hinge.get("palm1_length_m", 0.12))
    events: list[Event] = []
    for line in lines[1:]:
        if "pad" in line:
            events.append(PadSample(line["t"], line["pad"], line["s_m"], line["force_n"]))
        elif "palms" in line:
            events.append(palm_sample(line))
    return rig, events, truth


def _replay(watcher: BankObserver, events: list[Event], t0: float = 0.0) -> list[Estimate]:
    return list(watched(watcher, events, since=t0))


def _errors(estimates: list[Estimate], truth: dict, name: str) -> np.ndarray:
    t = np.array([e.t for e in estimates])
    return np.array([getattr(e, name.split("_")[0]) for e in estimates]) - np.interp(t, truth["t"], truth[name])


FILTER_BANKS = ("shape", "extended")  # the quasistatic observer has its own tests


@pytest.fixture(scope="module")
def nominal() -> tuple[RigDescription, list[Event], dict]:
    return _run("nominal", 107, 6.0)


@pytest.fixture(scope="module")
def replayed(nominal: tuple) -> Callable[[str], tuple[BankObserver, list[Estimate]]]:
    """Return the bank of a name after all of the run, and its estimates."""

    @cache
    def replayed(name: str) -> tuple[BankObserver, list[Estimate]]:
        watcher = observer.make(name, nominal[0])
        return watcher, _replay(watcher, nominal[1])

    return replayed


@pytest.mark.parametrize("name", FILTER_BANKS)
@pytest.mark.parametrize("seed", [None, *nightly(109, 112)])
def test_it_finds_the_radii_from_a_blind_start(name: str, seed: int | None, nominal: tuple, replayed) -> None:
    """In the run of all tests, or in one of 10 s of this seed."""
    rig, events, truth = nominal if seed is None else _run("nominal", seed, 10.0)
    estimates = replayed(name)[1] if seed is None else _replay(observer.make(name, rig), events)
    late = [e for e in estimates if e.t > 5.0]
    assert np.mean([e.valid for e in late]) > 0.95
    assert late[-1].valid
    for radius in ("r1", "r2"):
        error = _errors(late, truth, f"{radius}_m")
        assert np.sqrt(np.mean(error**2)) < 1e-4
        normalised = error / np.array([e.sd[radius] for e in late])
        assert np.sqrt(np.mean(normalised**2)) < 3.0
    assert late[-1].mass == pytest.approx(truth["mass_kg"], rel=0.03)
    assert late[-1].rho == pytest.approx(truth["rho_m"], rel=0.10)


def test_it_converges_with_friction_and_a_moving_hinge() -> None:
    rig, events, truth = _run("rig", 101, 10.0)
    estimates = _replay(observer.make("shape", rig), events)
    late = [e for e in estimates if e.t > 8.0]
    assert all(e.valid for e in late)
    assert np.sqrt(np.mean(_errors(late, truth, "r1_m") ** 2)) < 3e-4
    assert late[-1].mu == pytest.approx(truth["mu"], abs=0.08)


def test_the_touched_outline_is_accurate(nominal: tuple, replayed) -> None:
    _, _, truth = nominal
    watcher, estimates = replayed("shape")
    shape = watcher.shape(estimates[-1].t)
    assert shape is not None
    assert shape.touched.any()
    bins = (shape.theta[shape.touched] / (2 * np.pi) * NORMAL_BINS).astype(int)
    assert estimates[-1].touched == pytest.approx(len(set(bins)) / NORMAL_BINS)
    theta, h = np.array(truth["theta_rad"]), np.array(truth["h_m"])

    def error(turn: float) -> float:
        turned = np.interp((shape.theta + turn) % (2 * np.pi), np.append(theta, 2 * np.pi), np.append(h, h[0]))
        return float(np.sqrt(np.mean((shape.h - turned)[shape.touched] ** 2)))

    assert min(error(turn) for turn in np.linspace(-0.5, 0.5, 201)) < 5e-5
    touched_sd, untouched_sd = shape.h_sd[shape.touched].max(), shape.h_sd[~shape.touched].max()
    assert touched_sd < 1e-4 < untouched_sd


def test_with_one_contact_there_is_no_valid_estimate(nominal: tuple) -> None:
    rig, events, _ = nominal
    one_pad = [e for e in events if not (isinstance(e, PadSample) and e.pad == 2)]
    watcher = observer.make("shape", rig)
    estimates = _replay(watcher, one_pad)
    assert not any(e.valid for e in estimates)
    assert all(math.isnan(e.r1) for e in estimates)
    assert estimates[-1].phi1 == pytest.approx(
        events[-1].angles[0] if isinstance(events[-1], PalmSample) else 0.8, abs=1
    )
    assert watcher.shape(1.0) is None


def test_valid_estimates_are_finite(replayed) -> None:
    for estimate in replayed("extended")[1]:
        if estimate.valid:
            named = ("r1", "r2", "omega0", "s1", "s2", "phi1", "omega1", "phi2", "omega2", "rho", "psi")
            assert all(math.isfinite(getattr(estimate, n)) and math.isfinite(estimate.sd[n]) for n in named)


def test_a_late_event_is_fused_at_its_own_time(nominal: tuple) -> None:
    """Swapping neighbours of different sensors gives results identical to those of the right order.

    For filters in NumPy; `test_compiled_fusion` tests those in C. Events that are far too late are dropped.
    """
    rig, events, _ = nominal
    head = events[:600]
    swapped = head.copy()
    for i in range(40, len(swapped) - 2, 7):
        one, two = swapped[i], swapped[i + 1]
        both_pads = isinstance(one, PadSample) and isinstance(two, PadSample)
        if both_pads and one.t_sample < two.t_sample:
            swapped[i], swapped[i + 1] = two, one
    assert swapped != head
    right, late = observer.make("extended", rig), observer.make("extended", rig)
    for a, b in zip(head, swapped, strict=True):
        right.feed(a)
        late.feed(b)
    t = head[-1].t_sample
    assert repr(late.estimate(t)) == repr(right.estimate(t))
    assert late.late_dropped == 0
    late.feed(PadSample(t - 0.9, 1, 0.02))
    assert late.late_dropped == 1
    assert repr(late.estimate(t)) == repr(right.estimate(t))


def test_late_readings_leave_every_covariance_positive(nominal: tuple) -> None:
    """Readings up to 80 ms late at random, also across starts and prunings: time never runs backwards in a filter."""
    rig, events, truth = nominal
    random = np.random.default_rng(11)
    arrivals = sorted(events, key=lambda e: e.t_sample + random.uniform(0, 0.08) * (random.random() < 0.3))
    watcher = observer.make("shape", rig)
    estimates = []
    for i, event in enumerate(arrivals):
        watcher.feed(event)
        if i % 3 == 0:
            estimates.append(watcher.estimate(max(e.t_sample for e in arrivals[max(0, i - 40) : i + 1])))
            assert np.linalg.eigvalsh(watcher._fusion.bank.P[watcher._fusion.bank.best()]).min() > -1e-15
    assert estimates[-1].valid
    assert abs(_errors(estimates[-1:], truth, "r1_m")[0]) < 2e-4


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_non_finite_events_change_nothing(nominal: tuple, bad: float) -> None:
    rig, events, _ = nominal
    clean, dirty = observer.make("shape", rig), observer.make("shape", rig)
    for i, event in enumerate(events[:400]):
        clean.feed(event)
        dirty.feed(event)
        if i % 50 == 0:
            dirty.feed(PadSample(event.t_sample, 1, bad))
            dirty.feed(PadSample(bad, 2, 0.02))
            dirty.feed(PalmSample(event.t_sample, (bad, 1.5)))
    t = events[399].t_sample
    assert dirty.estimate(t) == clean.estimate(t)


def test_outliers_do_not_invalidate_the_estimate(nominal: tuple) -> None:
    rig, events, truth = nominal
    random = np.random.default_rng(3)
    corrupted = [
        replace(e, s=e.s + random.choice([-5e-3, 5e-3])) if isinstance(e, PadSample) and random.random() < 0.02 else e
        for e in events
    ]
    late = [e for e in _replay(observer.make("shape", rig), corrupted) if e.t > 4.0]
    assert np.mean([e.valid for e in late]) > 0.9
    assert np.sqrt(np.mean(_errors(late, truth, "r1_m") ** 2)) < 1.5e-4


def _put_back(watcher: BankObserver, first: list[Event], second: list[Event]) -> tuple[list[Estimate], float]:
    """Replay `first`, lift the object, and replay `second` two seconds later; the new estimates and the delay."""
    _replay(watcher, first)
    return _go_on_later(watcher, first[-1].t_sample, second)


def _go_on_later(watcher: BankObserver, t: float, second: list[Event]) -> tuple[list[Estimate], float]:
    watcher.feed(PadLift(t, 1))
    watcher.feed(PadLift(t, 2))
    assert not watcher.estimate(t + 0.01).valid
    assert not watcher.estimate(t + 1.0).valid
    delay = t + 2.0 - second[0].t_sample
    again = [replace(e, t_sample=e.t_sample + delay) for e in second]
    return _replay(watcher, again, t + 2.0), delay


def _settled_after(estimates: list[Estimate]) -> float:
    return next(e.t for e in estimates if e.valid) - estimates[0].t


def test_the_same_object_put_back_in_another_pose_is_recognised(nominal: tuple) -> None:
    """Two parts of one run: before the second the object has turned and the palms have moved on."""
    rig, events, truth = nominal
    first, second = ([e for e in events if low < e.t_sample < high] for low, high in ((0.0, 3.5), (3.5, 6.0)))
    psi = np.interp([0.0, 3.5], truth["t"], truth["psi_rad"])
    assert abs(psi[1] - psi[0]) > 0.1
    watcher = observer.make("shape", rig)
    (gauge,) = _errors(_replay(watcher, first)[-1:], truth, "psi_rad")
    known, delay = _go_on_later(watcher, first[-1].t_sample, second)
    mass, touched = watcher._session.track.mass, known[-1].touched
    valid = [e for e in known if e.valid]
    assert {e.object_count for e in valid} == {1}
    shifted = [replace(e, t=e.t - delay) for e in valid]
    assert np.sqrt(np.mean(_errors(shifted, truth, "r1_m") ** 2)) < 1.5e-4
    # ψ continues in the gauge of the map, the turn since the first reading up to the error of a blind start
    assert abs(gauge + psi[0]) < 0.1
    assert np.abs(_errors(shifted, truth, "psi_rad") - gauge).max() < 0.05
    assert valid[0].mass == pytest.approx(truth["mass_kg"], rel=0.02)
    assert mass.sd < 0.01 * mass.value
    assert touched > 0.15
    blind = _replay(observer.make("shape", rig), second, 3.5)
    assert _settled_after(known) < 0.7 * _settled_after(blind)


@pytest.mark.parametrize("other", [108, *nightly(104)])
def test_another_object_increments_the_count_and_is_found(nominal: tuple, other: int) -> None:
    rig, events, _ = nominal
    _, second, truth = _run("nominal", other, 6.0)
    watcher = observer.make("shape", rig)
    found, delay = _put_back(watcher, events, second)
    valid = [e for e in found if e.valid]
    assert {e.object_count for e in valid} == {2}
    assert valid[-1] is found[-1]
    late = [replace(e, t=e.t - delay) for e in valid if e.t - delay > 4.5]
    assert np.sqrt(np.mean(_errors(late, truth, "r1_m") ** 2)) < 1e-4
    assert late[-1].mass == pytest.approx(truth["mass_kg"], rel=0.03)


def test_the_object_count_never_decreases(nominal: tuple) -> None:
    """Same, other, same: no estimate is valid before the identity is decided."""
    rig, events, _ = nominal
    _, other, _ = _run("nominal", 108, 4.0)
    watcher = observer.make("shape", rig)
    estimates = _replay(watcher, events[:1000])
    last, expected = events[999], []
    for stretch in (events[1000:], other, other):
        estimates += _put_back(watcher, [last], stretch)[0]
        last = replace(stretch[-1], t_sample=estimates[-1].t)
        assert estimates[-1].valid
        expected.append(estimates[-1].object_count)
    counts = [e.object_count for e in estimates]
    assert counts == sorted(counts)
    assert expected == [1, 2, 2]


def test_the_extended_observer_keeps_the_count_of_the_same_object(nominal: tuple) -> None:
    rig, events, truth = nominal
    watcher = observer.make("extended", rig)
    first, second = ([e for e in events if low < e.t_sample < high] for low, high in ((0.0, 2.0), (2.0, 6.0)))
    estimates, delay = _put_back(watcher, first, second)
    assert len({e.object_count for e in estimates if e.valid}) == 1
    assert estimates[-1].valid
    assert abs(_errors([replace(estimates[-1], t=estimates[-1].t - delay)], truth, "r1_m")[0]) < 2e-4


def test_a_small_bank_always_starts_blind(nominal: tuple) -> None:
    rig, events, _ = nominal
    watcher = BankObserver(ShapeFilters(rig, 8), rig)
    _replay(watcher, events[:1000])
    _put_back(watcher, [events[999]], events[1000:1300])
    assert not watcher._fusion.forgetting.prior_age_s.any()


@pytest.mark.parametrize("kind", [ShapeFilters, ExtendedFilters])
def test_the_filters_curvature_rows_match_their_outline(kind: type) -> None:
    filters = kind(RigDescription(hinge="fixed"), 8)
    palms = PalmTracker(2e-4)
    palms.feed(PalmSample(0.0, (0.8, 1.6), (0.0, 0.0), (0.0, 0.0)))
    start = blind_start((0.02, 0.021), palms.motion(0.0), 8, True, np.random.default_rng(1))
    filters.start(start, palms, 0.0)
    theta, step = np.linspace(0, 2 * np.pi, 72, endpoint=False), 1e-4
    for member in range(8):
        coefficients, _ = filters.outline(member)
        h, up, down = (modelled.basis(theta + by) @ coefficients for by in (0.0, step, -step))
        v = h + (up - 2 * h + down) / step**2
        assert filters.curvature @ filters.bank.x[member] == pytest.approx(v, abs=1e-6)


def test_valid_outlines_are_convex() -> None:
    """A run whose untouched side was concave by 2.9 mm before the filters had a convexity constraint."""
    rig, events, _ = _run("odd", 111, 10.0)
    watcher = observer.make("shape", rig)
    valid = 0
    for estimate in watched(watcher, events):
        if estimate.valid:
            valid += 1
            shape = watcher.shape(estimate.t)
            spectrum = np.fft.rfft(shape.h)
            v = np.fft.irfft(spectrum * (1 - np.arange(len(spectrum)) ** 2.0), len(shape.h))
            assert v.min() > -2e-4, "between the 72 constrained normals"
    assert valid > 100


def test_a_map_that_causes_divergence_is_discarded(nominal: tuple) -> None:
    """The known object's readings become inconsistent: the start after next is blind again."""
    rig, events, _ = nominal
    watcher = observer.make("shape", rig)
    _replay(watcher, events[:1000])
    assert watcher._hypotheses.memory.recall() is not None
    random = np.random.default_rng(5)
    nonsense = [
        replace(e, s=0.02 + 0.01 * random.uniform(-1, 1)) if isinstance(e, PadSample) else e for e in events[1000:]
    ]
    estimates = _replay(watcher, nonsense, events[1000].t_sample)
    assert watcher._hypotheses.memory.recall() is None
    assert not estimates[-1].valid


@pytest.mark.parametrize("known", [False, True])
def test_losing_an_object_before_it_was_known_keeps_its_start_time(nominal: tuple, known: bool) -> None:
    """So that a slow smoother on a busy machine can use all readings of the object."""
    rig, events, _ = nominal
    watcher = observer.make("shape", rig)
    right = events[: 1000 if known else 5]
    _replay(watcher, right)
    begun, t = watcher.start_time, right[-1].t_sample
    random = np.random.default_rng(5)
    for event in events[len(right) :]:
        corrupted = replace(event, s=0.02 + 0.01 * random.uniform(-1, 1)) if isinstance(event, PadSample) else event
        watcher.feed(corrupted)
        valid = watcher.estimate(event.t_sample).valid
        assert known or not valid
        if watcher.object_count > 1:
            break
    assert watcher.object_count == 2
    assert watcher.start_time == begun if not known else watcher.start_time > t


def test_a_short_lift_is_bridged_without_a_restart(nominal: tuple) -> None:
    rig, events, _ = nominal
    watcher = observer.make("shape", rig)
    bridged = [e for e in events if not (3.0 < e.t_sample < 3.2 and isinstance(e, PadSample))]
    at = next(i for i, e in enumerate(bridged) if e.t_sample > 3.0)
    estimates = _replay(watcher, [*bridged[:at], PadLift(3.0, 1), *bridged[at:]])
    assert not any(e.valid for e in estimates if 3.02 < e.t < 3.19)
    assert estimates[-1].object_count == 1
    assert estimates[-1].valid


def test_after_a_lift_from_both_pads_the_estimate_is_re_initialised(nominal: tuple) -> None:
    """The object may have turned meanwhile, and filters forced to fit it would be overconfident."""
    rig, events, _ = nominal
    first, second = ([e for e in events if low < e.t_sample < high] for low, high in ((0.0, 3.0), (4.0, 4.4)))
    watcher = observer.make("shape", rig)
    _replay(watcher, first)
    for pad in (1, 2):
        watcher.feed(PadLift(3.0, pad))
    for t in np.arange(3.0, 3.2, 0.01):
        watcher.estimate(float(t))
    _replay(watcher, [replace(e, t_sample=e.t_sample - 0.8) for e in second], 3.2)
    assert watcher._session.track is not None
    assert watcher._session.track.age(3.6) < 0.5


def test_a_gap_in_the_readings_restarts_the_estimate(nominal: tuple) -> None:
    rig, events, _ = nominal
    gap = [e for e in events if not 2.0 < e.t_sample < 3.0]
    estimates = _replay(observer.make("shape", rig), gap)
    assert not any(e.valid for e in estimates if 2.2 < e.t < 2.99)
    assert all(math.isnan(e.r1) for e in estimates if 2.5 < e.t < 2.99)
    assert estimates[-1].object_count == 1
    assert estimates[-1].valid


def _without_palms(events: list[Event], since: float, until: float) -> list[Event]:
    return [e for e in events if not (isinstance(e, PalmSample) and since < e.t_sample < until)]


@pytest.mark.parametrize("name", FILTER_BANKS)
def test_it_continues_after_a_short_gap_in_the_palms_reports(nominal: tuple, name: str) -> None:
    """Unknown palm angles do not mean that the object is lost."""
    rig, events, truth = nominal
    watcher = observer.make(name, rig)
    estimates = _replay(watcher, _without_palms(events, 3.0, 3.3))
    assert any(e.valid for e in estimates if 2.8 < e.t < 3.0)
    assert not any(e.valid for e in estimates if 3.16 < e.t < 3.3)
    assert estimates[-1].object_count == 1
    late = [e for e in estimates if e.t > 5.3]
    assert all(e.valid for e in late)
    assert np.sqrt(np.mean(_errors(late, truth, "r1_m") ** 2)) < 1.5e-4
    assert watcher.late_dropped == 0


def test_it_neither_starts_nor_fuses_while_the_palms_are_unknown(nominal: tuple) -> None:
    rig, events, _ = nominal
    watcher = observer.make("shape", rig)
    first_report = next(e for e in events if isinstance(e, PalmSample))
    pads = [e for e in events if isinstance(e, PadSample)]
    estimates = _replay(watcher, [first_report, *(e for e in pads if e.t_sample > 0.2)])
    assert watcher.object_count == 0
    assert all(math.isnan(e.r1) for e in estimates)
    assert math.isnan(estimates[-1].phi1), "palm angles reported seconds ago are not published"

    with_pads, without = observer.make("shape", rig), observer.make("shape", rig)
    gap = _without_palms(events, 3.0, 3.3)
    _replay(with_pads, gap)
    _replay(without, [e for e in gap if not 3.18 < e.t_sample < 3.26])
    assert with_pads.estimate(6.0) == without.estimate(6.0)


def test_a_long_gap_in_the_palms_reports_ends_the_estimate(nominal: tuple) -> None:
    rig, events, _ = nominal
    estimates = _replay(observer.make("shape", rig), _without_palms(events, 2.0, 3.0))
    assert not any(e.valid for e in estimates if 2.16 < e.t < 3.0)
    assert all(math.isnan(e.r1) for e in estimates if 2.45 < e.t < 2.99)
    assert estimates[-1].valid


@pytest.mark.parametrize("name", FILTER_BANKS)
def test_with_one_silent_pad_the_other_still_gives_an_estimate(nominal: tuple, replayed, name: str) -> None:
    rig, events, truth = nominal
    one_pad = [e for e in events if not (isinstance(e, PadSample) and e.pad == 1 and 3.0 < e.t_sample < 3.35)]
    estimates = _replay(observer.make(name, rig), one_pad)
    before = [e for e in estimates if 2.8 < e.t < 3.0]
    alone = [e for e in estimates if 3.15 < e.t < 3.35]
    assert all(e.valid for e in before)
    assert not any(e.valid for e in alone)
    with_both = next(e for e in replayed(name)[1] if e.t == alone[-1].t)
    assert alone[-1].sd["s1"] > 1.15 * with_both.sd["s1"]
    assert np.abs(_errors(alone, truth, "r1_m")).max() < 4 * alone[-1].sd["r1"] < 1e-3
    assert estimates[-1].object_count == 1
    assert estimates[-1].valid


def test_constant_readings_never_give_a_sharp_valid_estimate() -> None:
    """A stuck pad and palms at rest: the shape is not observable, and the sd must show it."""
    rig = RigDescription(hinge="fixed")
    events: list[Event] = []
    for i in range(600):
        t = i * 0.01
        events += [PalmSample(t, (0.78, 1.57), (0.0, 0.0), (0.0, 0.0)), PadSample(t, 1, 0.02), PadSample(t, 2, 0.02)]
    for estimate in _replay(observer.make("shape", rig), events):
        assert not estimate.valid or max(estimate.sd["r1"], estimate.sd["r2"]) < 4e-4
    assert not estimate.valid


def test_palm_angles_without_rates_are_sufficient(nominal: tuple) -> None:
    rig, events, truth = nominal
    bare = [PalmSample(e.t_sample, e.angles) if isinstance(e, PalmSample) else e for e in events]
    late = [e for e in _replay(observer.make("shape", rig), bare) if e.t > 4.0]
    assert np.sqrt(np.mean(_errors(late, truth, "r1_m") ** 2)) < 5e-4


def test_without_forces_only_the_mass_is_missing(nominal: tuple) -> None:
    rig, events, _ = nominal
    bare = [replace(e, force=None) if isinstance(e, PadSample) else e for e in events]
    last = _replay(observer.make("shape", rig), bare)[-1]
    assert last.valid
    assert math.isnan(last.mass)


def test_the_virtual_machine_gives_the_same_answer(nominal: tuple, tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For generated code; an observer with handwritten C needs a compiler."""
    rig, events, _ = nominal
    fast = observer.make("extended", rig)
    _replay(fast, events[:150])

    monkeypatch.setattr(compiled, "_opened", lambda _: None)
    monkeypatch.setattr(building, "build", lambda *_: False)
    monkeypatch.setattr(extended, "library", extended.library.__wrapped__)  # without its cache
    slow = observer.make("extended", rig)
    assert (fast.backend, slow.backend) == ("c", "vm")
    _replay(slow, events[:150])
    a, b = fast.estimate(events[149].t_sample), slow.estimate(events[149].t_sample)
    assert a.r1 == pytest.approx(b.r1, rel=1e-6)
    assert a.sd["r1"] == pytest.approx(b.sd["r1"], rel=1e-6)


@pytest.mark.parametrize(("kind", "seed", "end"), [("friction", 43, 20.0), *nightly(("rig", 2, 30.0))])
def test_the_outline_does_not_change_while_the_palms_rest(kind: str, seed: int, end: float) -> None:
    run = simulated(kind, seed, end, rests=((10.0, end),))
    bank = observer.make("shape", run.rig)
    events = sorted(run.events, key=lambda event: event.t_sample)
    before, moved = None, []
    for tick in range(100, round(100 * end) - 50):
        t = 0.01 * tick
        while events and events[0].t_sample <= t:
            bank.feed(events.pop(0))
        estimate = bank.estimate(t)
        if t > 12.0 and tick % 50 == 0:
            outline = bank.shape(t)
            assert estimate.valid
            assert outline is not None
            before = before or outline
            difference = (outline.h - before.h)[before.touched] / before.h_sd[before.touched]
            moved.append(math.sqrt(float(np.mean(difference**2))))
    assert max(moved) < 1.0


def test_each_pads_own_noise_sets_its_weight(nominal) -> None:
    """With one pad five times as noisy, the estimate is more accurate if the noise is assigned to the right pad."""
    rig, events, truth = nominal
    random = np.random.default_rng(5)
    quiet, noisy = PadSensor(), PadSensor(noise=5e-4)
    pads = {1: (noisy, quiet), 2: (quiet, noisy)}
    for bad in pads:
        heard = [
            replace(event, s=event.s + random.normal(0.0, noisy.noise))
            if isinstance(event, PadSample) and event.pad == bad
            else event
            for event in events
        ]
        misses = []
        for noisy_pad in (bad, 3 - bad):
            estimates = _replay(observer.make("shape", replace(rig, pads=pads[noisy_pad])), heard)[-200:]
            misses.append(np.hypot(*(_errors(estimates, truth, f"r{palm}_m") for palm in (1, 2))))
        assert np.median(misses[0]) < 0.7 * np.median(misses[1])
