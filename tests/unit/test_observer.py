"""The observer on simulated runs: it finds the outline from a blind start, and survives what a rig does to it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from palmd import observer
from palmd.events import Estimate, Event, PadLift, PadSample, PalmSample, RigDescription
from palmd.model import compiled
from palmd.observer.live import BankObserver
from palmd.rig.simulate import simulate_log


def _run(kind: str, seed: int, duration_s: float) -> tuple[RigDescription, list[Event], dict]:
    lines, truth = simulate_log(kind, seed, duration_s)
    hinge = lines[0]["rig"]["hinge"]
    rig = RigDescription(hinge=hinge["mode"], palm1_length=hinge.get("palm1_length_m", 0.12))
    events: list[Event] = []
    for line in lines[1:]:
        if "pad" in line:
            events.append(PadSample(line["t"], line["pad"], line["s_m"], line["force_n"]))
        elif "palms" in line:
            p = line["palms"]
            names = ("phi1_rad", "phi2_rad", "omega1_rad_s", "omega2_rad_s", "alpha1_rad_s2", "alpha2_rad_s2")
            events.append(PalmSample(line["t"], *(p[n] for n in names)))
    return rig, events, truth


def _replay(watcher: BankObserver, events: list[Event], t0: float = 0.0) -> list[Estimate]:
    estimates, tick = [], t0 + 0.01
    for event in events:
        while tick < event.t_sample:
            estimates.append(watcher.estimate(tick))
            tick += 0.01
        watcher.feed(event)
    return estimates


def _errors(estimates: list[Estimate], truth: dict, name: str) -> np.ndarray:
    t = np.array([e.t for e in estimates])
    return np.array([getattr(e, name.split("_")[0]) for e in estimates]) - np.interp(t, truth["t"], truth[name])


@pytest.fixture(scope="module")
def nominal() -> tuple[RigDescription, list[Event], dict]:
    return _run("nominal", 107, 6.0)


@pytest.mark.parametrize("name", observer.OBSERVERS)
@pytest.mark.parametrize("seed", [107, 109, 112])
def test_it_finds_the_radii_from_a_blind_start(name: str, seed: int) -> None:
    rig, events, truth = _run("nominal", seed, 10.0)
    estimates = _replay(observer.make(name, rig), events)
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


def test_friction_and_a_travelling_hinge_are_no_obstacle() -> None:
    rig, events, truth = _run("rig", 101, 10.0)
    estimates = _replay(observer.make("shape", rig), events)
    late = [e for e in estimates if e.t > 8.0]
    assert all(e.valid for e in late)
    assert np.sqrt(np.mean(_errors(late, truth, "r1_m") ** 2)) < 3e-4
    assert late[-1].mu == pytest.approx(truth["mu"], abs=0.08)


def test_the_outline_is_right_where_it_was_touched(nominal: tuple) -> None:
    rig, events, truth = nominal
    watcher = observer.make("shape", rig)
    estimates = _replay(watcher, events)
    shape = watcher.shape(estimates[-1].t)
    assert shape is not None
    assert shape.touched.any()
    assert estimates[-1].touched == pytest.approx(shape.touched.mean())
    theta, h = np.array(truth["theta_rad"]), np.array(truth["h_m"])

    def error(turn: float) -> float:
        turned = np.interp((shape.theta + turn) % (2 * np.pi), np.append(theta, 2 * np.pi), np.append(h, h[0]))
        return float(np.sqrt(np.mean((shape.h - turned)[shape.touched] ** 2)))

    assert min(error(turn) for turn in np.linspace(-0.5, 0.5, 201)) < 5e-5
    felt, unfelt = shape.h_sd[shape.touched].max(), shape.h_sd[~shape.touched].max()
    assert felt < 1e-4 < unfelt


def test_before_two_touches_it_says_nothing_and_never_lies(nominal: tuple) -> None:
    rig, events, _ = nominal
    one_pad = [e for e in events if not (isinstance(e, PadSample) and e.pad == 2)]
    watcher = observer.make("shape", rig)
    estimates = _replay(watcher, one_pad)
    assert not any(e.valid for e in estimates)
    assert all(math.isnan(e.r1) for e in estimates)
    assert estimates[-1].phi1 == pytest.approx(events[-1].phi1 if isinstance(events[-1], PalmSample) else 0.8, abs=1)
    assert watcher.shape(1.0) is None


def test_valid_always_means_finite(nominal: tuple) -> None:
    rig, events, _ = nominal
    for estimate in _replay(observer.make("extended", rig), events):
        if estimate.valid:
            named = ("r1", "r2", "omega0", "s1", "s2", "phi1", "omega1", "phi2", "omega2", "rho", "psi")
            assert all(math.isfinite(getattr(estimate, n)) and math.isfinite(estimate.sd[n]) for n in named)


def test_a_late_event_is_fused_at_its_own_time(nominal: tuple) -> None:
    """Swap neighbours of different sensors: the answer must be that of the right order, to the last bit."""
    rig, events, _ = nominal
    head = events[:600]
    swapped = head.copy()
    for i in range(40, len(swapped) - 2, 7):
        one, two = swapped[i], swapped[i + 1]
        both_pads = isinstance(one, PadSample) and isinstance(two, PadSample)
        if both_pads and one.t_sample < two.t_sample:
            swapped[i], swapped[i + 1] = two, one
    assert swapped != head
    right, late = observer.make("shape", rig), observer.make("shape", rig)
    for a, b in zip(head, swapped, strict=True):
        right.feed(a)
        late.feed(b)
    t = head[-1].t_sample
    assert late.estimate(t) == right.estimate(t)
    assert late.late_dropped == 0


def test_an_event_far_too_late_is_counted_and_dropped(nominal: tuple) -> None:
    rig, events, _ = nominal
    watcher = observer.make("shape", rig)
    _replay(watcher, events[:600])
    before = watcher.estimate(events[599].t_sample)
    watcher.feed(PadSample(events[599].t_sample - 0.9, 1, 0.02, None))
    assert watcher.late_dropped == 1
    assert watcher.estimate(events[599].t_sample).r1 == before.r1


def test_lateness_of_any_kind_leaves_every_covariance_positive(nominal: tuple) -> None:
    """Readings up to 80 ms late at random, across starts and prunings: time never runs backwards in a filter."""
    rig, events, truth = nominal
    random = np.random.default_rng(11)
    arrivals = sorted(events, key=lambda e: e.t_sample + random.uniform(0, 0.08) * (random.random() < 0.3))
    watcher = observer.make("shape", rig)
    estimates = []
    for i, event in enumerate(arrivals):
        watcher.feed(event)
        if i % 3 == 0:
            estimates.append(watcher.estimate(max(e.t_sample for e in arrivals[max(0, i - 40) : i + 1])))
            assert np.linalg.eigvalsh(watcher._bank.P[watcher._bank.best()]).min() > -1e-15
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
            dirty.feed(PalmSample(event.t_sample, bad, 1.5))
    t = events[399].t_sample
    assert dirty.estimate(t) == clean.estimate(t)


def test_outliers_do_not_throw_it(nominal: tuple) -> None:
    rig, events, truth = nominal
    random = np.random.default_rng(3)
    spoilt = [
        replace(e, s=e.s + random.choice([-5e-3, 5e-3])) if isinstance(e, PadSample) and random.random() < 0.02 else e
        for e in events
    ]
    late = [e for e in _replay(observer.make("shape", rig), spoilt) if e.t > 4.0]
    assert np.mean([e.valid for e in late]) > 0.9
    assert np.sqrt(np.mean(_errors(late, truth, "r1_m") ** 2)) < 1.5e-4


def test_a_lifted_object_ends_the_estimate_and_the_next_one_counts_up(nominal: tuple) -> None:
    rig, events, _ = nominal
    watcher = observer.make("shape", rig)
    first = _replay(watcher, events)
    t = events[-1].t_sample
    watcher.feed(PadLift(t, 1))
    watcher.feed(PadLift(t, 2))
    assert not watcher.estimate(t + 0.01).valid
    assert not watcher.estimate(t + 1.0).valid
    again = [replace(e, t_sample=e.t_sample + t + 2.0) for e in events]
    second = _replay(watcher, again, t + 2.0)
    assert first[-1].object_count == 1
    assert second[-1].object_count == 2
    assert second[-1].valid
    assert second[-1].r1 == pytest.approx(first[-1].r1, abs=1e-4)


def test_a_short_lift_is_bridged_without_starting_again(nominal: tuple) -> None:
    rig, events, _ = nominal
    watcher = observer.make("shape", rig)
    bridged = [e for e in events if not (3.0 < e.t_sample < 3.2 and isinstance(e, PadSample))]
    at = next(i for i, e in enumerate(bridged) if e.t_sample > 3.0)
    estimates = _replay(watcher, [*bridged[:at], PadLift(3.0, 1), *bridged[at:]])
    assert not any(e.valid for e in estimates if 3.02 < e.t < 3.19)
    assert estimates[-1].object_count == 1
    assert estimates[-1].valid


def test_a_gap_in_the_readings_starts_it_again(nominal: tuple) -> None:
    rig, events, _ = nominal
    gap = [e for e in events if not 2.0 < e.t_sample < 3.0]
    estimates = _replay(observer.make("shape", rig), gap)
    assert not any(e.valid for e in estimates if 2.2 < e.t < 2.99)
    assert estimates[-1].object_count == 2
    assert estimates[-1].valid


def test_constant_readings_never_become_a_settled_claim_of_motion() -> None:
    """A stuck pad and still palms: nothing can be learnt of the shape, and the sd has to say so."""
    rig = RigDescription(hinge="fixed")
    events: list[Event] = []
    for i in range(600):
        t = i * 0.01
        events += [PalmSample(t, 0.78, 1.57, 0.0, 0.0, 0.0, 0.0), PadSample(t, 1, 0.02), PadSample(t, 2, 0.02)]
    for estimate in _replay(observer.make("shape", rig), events):
        assert not estimate.valid or max(estimate.sd["r1"], estimate.sd["r2"]) < 4e-4
    assert not estimate.valid


def test_without_plan_rates_the_angles_alone_will_do(nominal: tuple) -> None:
    rig, events, truth = nominal
    bare = [PalmSample(e.t_sample, e.phi1, e.phi2) if isinstance(e, PalmSample) else e for e in events]
    late = [e for e in _replay(observer.make("shape", rig), bare) if e.t > 4.0]
    assert np.sqrt(np.mean(_errors(late, truth, "r1_m") ** 2)) < 5e-4


def test_missing_forces_cost_the_mass_only(nominal: tuple) -> None:
    rig, events, _ = nominal
    bare = [replace(e, force=None) if isinstance(e, PadSample) else e for e in events]
    last = _replay(observer.make("shape", rig), bare)[-1]
    assert last.valid
    assert math.isnan(last.mass)


def test_the_same_events_give_the_same_bits(nominal: tuple) -> None:
    rig, events, _ = nominal
    runs = [_replay(observer.make("extended", rig), events[:500]) for _ in range(2)]
    assert repr(runs[0]) == repr(runs[1])


def test_the_virtual_machine_gives_the_same_answer(nominal: tuple, tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig, events, _ = nominal
    fast = observer.make("shape", rig)
    _replay(fast, events[:150])

    def fails(*_: object) -> None:
        raise OSError("no compiler")

    monkeypatch.setattr(compiled, "_compile", fails)
    slow = observer.make("shape", rig)
    assert (fast.backend, slow.backend) == ("c", "vm")
    _replay(slow, events[:150])
    a, b = fast.estimate(events[149].t_sample), slow.estimate(events[149].t_sample)
    assert a.r1 == pytest.approx(b.r1, rel=1e-6)
    assert a.sd["r1"] == pytest.approx(b.sd["r1"], rel=1e-6)
