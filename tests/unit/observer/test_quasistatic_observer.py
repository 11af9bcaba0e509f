"""The quasistatic observer on balanced and unbalanced objects, and on invalid input."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from campaign import nightly
from simulated import simulated, watched

from palmd.events import Event, PadLift, PadSample, PalmSample
from palmd.messages import estimate_fields, named_state_is_finite, stamp
from palmd.observer.multi_start import BLOCKS, MultiStart, Spread
from palmd.observer.quasistatic import QuasistaticObserver
from palmd.quantities import ESTIMATE
from palmd.system.description import RigDescription
from tools.published import validate
from tools.studies.paper_poses import BalancedRun, balanced_run

LUMP = np.array([0.020, 0.0015, -0.001, 0.004, 0.0, 0.0004, 0.0005])
RIG = RigDescription(hinge="fixed")


def balanced(seconds: float = 8.0, swing: float = 0.22) -> BalancedRun:
    t = np.arange(0.0, seconds, 0.01)
    return balanced_run(LUMP, 2.6, t, 0.75 + swing * np.sin(0.8 * t), 1.65 + swing * np.sin(1.3 * t + 0.5))


def events_of(run: BalancedRun, noise_m: float, seed: int = 0, mass: float = 0.1) -> list[Event]:
    rng = np.random.default_rng(seed)
    events: list[Event] = []
    for k, t in enumerate(run.t.tolist()):
        phi1, phi2 = run.phi1[k], run.phi2[k]
        events.append(PalmSample(t, (phi1 + rng.normal(0, 2e-4), phi2 + rng.normal(0, 2e-4))))
        forces = 9.81 * math.sin(phi1 + phi2) / math.sin(phi2), 9.81 * math.sin(phi1) / math.sin(phi2)
        for pad, s, f in ((1, run.contacts.s1[k], forces[0]), (2, run.contacts.s2[k], forces[1])):
            events.append(PadSample(t + 1e-4 * pad, pad, s + rng.normal(0, noise_m), mass * f))
    return events


def test_a_balanced_object_is_estimated_to_less_than_a_millimetre_and_consistently():
    run = balanced()
    estimates = [e for e in watched(QuasistaticObserver(RIG), events_of(run, 1e-4), 8.0) if e.valid]
    assert estimates[0].t < 2.5
    late = [e for e in estimates if e.t > 4.5]
    at = [round(e.t / 0.01) - 1 for e in late]
    errors = np.array([(e.r1 - run.contacts.r1[k], e.r2 - run.contacts.r2[k]) for e, k in zip(late, at, strict=True)])
    sds = np.array([(e.sd["r1"], e.sd["r2"]) for e in late])
    assert np.sqrt((errors**2).mean()) < 1.0e-3
    assert ((errors / sds) ** 2).mean() < 2.0
    psi = np.array([e.psi - run.psi[k] for e, k in zip(late, at, strict=True)])
    assert psi.std() < 0.12 < 0.3 * np.ptp(run.psi)
    assert np.ptp(run.psi) > 0.5
    assert late[-1].mass == pytest.approx(0.1, rel=0.01)  # at rest, section 4.1
    assert max(e.e_c for e in late) < 5e-4
    assert all(math.isfinite(e.e_f) for e in late)


@pytest.mark.parametrize("seeds", [(401, 402), *nightly(((403, 404),))])
def test_estimates_of_an_object_with_friction_are_consistent(seeds):
    ratios = []
    for seed in seeds:
        run = simulated("friction", seed, 8.0)
        observer = QuasistaticObserver(run.rig)
        for estimate in watched(observer, run.events, 7.9):
            if estimate.valid:
                assert named_state_is_finite(estimate)
                k = round(estimate.t / 0.01)
                normals = run.palms[k, 0] - run.truth.psi[k] - math.pi / 2
                true = np.interp(normals % (2 * math.pi), run.truth.theta, run.truth.h)
                ratios.append(((estimate.r1 - true) / estimate.sd["r1"]) ** 2)
    assert len(ratios) > 500
    assert 0.1 < np.mean(ratios) < 3.0


def test_every_estimate_can_be_published():
    run = balanced(3.0)
    observer = QuasistaticObserver(RIG)
    estimate = list(watched(observer, events_of(run, 1e-4), 3.0))[-1]
    assert estimate.valid
    assert validate(ESTIMATE, stamp(estimate_fields(estimate), 1.0, 1.0, 1)) == []
    outline = observer.shape(3.0)
    assert outline is not None
    assert len(outline.theta) >= 180
    assert outline.touched.any()
    assert (outline.h_sd > 0.5e-3).all()


def test_estimates_are_reproducible_and_late_events_change_little():
    events = events_of(balanced(4.0), 1e-4)
    first = list(watched(QuasistaticObserver(RIG), events, 4.0))
    again = list(watched(QuasistaticObserver(RIG), events, 4.0))
    assert first[-1].r1 == again[-1].r1
    assert first[-1].psi == again[-1].psi
    swapped = events.copy()
    for i in range(300, len(events) - 3, 3):
        swapped[i], swapped[i + 2] = swapped[i + 2], swapped[i]
    late = list(watched(QuasistaticObserver(RIG), swapped, 4.0))
    assert late[-1].r1 == pytest.approx(first[-1].r1, abs=1e-4)


def test_the_set_of_starts_narrows_and_the_window_slides():
    run = balanced(26.0, swing=0.1)
    assert run.jumps == 0
    observer = QuasistaticObserver(RIG)
    estimates = list(watched(observer, events_of(run, 1e-4), 26.0))
    assert observer._rounds >= 4
    assert len(observer._nodes) == observer._nodes.maxlen
    late = [e for e in estimates if e.t > 22.0]
    off = [e.r1 - run.contacts.r1[round(e.t / 0.01) - 1] for e in late]
    assert all(e.valid and e.object_count == 1 for e in late)
    assert np.sqrt(np.mean(np.square(off))) < 1.5e-3


def test_after_a_jump_it_restarts():
    """Where its stable pose vanishes, the object falls into another one, too fast to be tracked."""
    run = balanced(20.0)
    assert run.jumps == 1
    observer = QuasistaticObserver(RIG)
    estimates = list(watched(observer, events_of(run, 1e-4), 20.0))
    counts = [e.object_count for e in estimates]
    assert counts[1300] == 1
    assert counts[-1] == 2
    assert not all(e.valid for e in estimates[1400:1700])
    late = [e for e in estimates if e.t > 18.0]
    off = [e.r1 - run.contacts.r1[round(e.t / 0.01) - 1] for e in late]
    assert all(e.valid for e in late)
    assert np.sqrt(np.mean(np.square(off))) < 2e-3


def test_after_a_lift_there_is_no_estimate_and_the_count_increases():
    run = balanced(8.0)
    events = [e for e in events_of(run, 1e-4) if not 3.0 < e.t_sample < 3.6 or isinstance(e, PalmSample)]
    events.insert(0, PadLift(0.0, 1))
    observer = QuasistaticObserver(RIG)
    estimates = list(watched(observer, events, 8.0))
    by_time = {round(e.t, 2): e for e in estimates}
    assert by_time[2.9].valid
    assert not by_time[3.3].valid
    assert not by_time[3.55].valid
    assert by_time[7.9].valid
    assert (by_time[2.9].object_count, by_time[7.9].object_count) == (1, 2)


def test_a_reported_lift_makes_the_estimate_invalid_at_once():
    events = events_of(balanced(4.0), 1e-4)
    observer = QuasistaticObserver(RIG)
    assert list(watched(observer, events, 3.5))[-1].valid
    observer.feed(PadLift(3.5, 2))
    assert not observer.estimate(3.51).valid


def test_invalid_events_are_counted_and_change_nothing():
    events = events_of(balanced(3.0), 1e-4)
    observer = QuasistaticObserver(RIG)
    clean = list(watched(QuasistaticObserver(RIG), events, 3.0))[-1]
    broken = []
    for i, event in enumerate(events):
        broken.append(event)
        if i % 50 == 0 and isinstance(event, PalmSample):
            broken.append(dataclasses.replace(event, angles=(math.nan, event.angles[1])))
            broken.append(PadSample(event.t_sample, 1, math.inf))
    after_broken = list(watched(observer, broken, 3.0))[-1]
    assert observer.late_dropped == len(broken) - len(events) > 0
    assert after_broken.r1 == clean.r1


def test_constant_readings_and_parallel_palms_do_not_raise():
    observer = QuasistaticObserver(RIG)
    for phi2 in (1.6, math.pi, 0.0):
        events: list[Event] = []
        for k in range(400):
            t = k * 0.01
            events += [PalmSample(t, (0.8, phi2)), PadSample(t, 1, 0.02), PadSample(t, 2, 0.02)]
        for estimate in watched(observer, events, 4.0):
            assert not estimate.valid or named_state_is_finite(estimate)
        observer.reset()


def judged(run: BalancedRun, spread: Spread) -> MultiStart:
    """All initial conditions of the spread, integrated over the exact readings of a run."""
    beginnings = MultiStart(spread, run.readings[0], 0.0, 0.02, 0.01, softening=0.0)
    for here, there in zip(run.readings, run.readings[1:], strict=False):
        beginnings.step(here, there)
    for _ in range(BLOCKS):
        beginnings.judge()
    return beginnings


def test_diverging_starts_get_zero_weight():
    run = balanced(2.0)
    beginnings = judged(run, Spread(0.02, 0.019, 0.0, 0.02))
    weights = beginnings.weights()
    assert np.isfinite(beginnings.state).all()
    assert 0 < np.count_nonzero(weights == 0.0) < len(weights)
    assert weights.sum() == pytest.approx(1.0)


def test_the_conflict_measure_determines_the_mean_radius():
    """With exact readings the likeliest start is the true one, though all are in balance."""
    run = balanced(8.0)
    true = (run.contacts.r1[0] + run.contacts.r2[0]) / 2
    beginnings = judged(run, Spread(true + 8e-4, 4e-3, 0.0, 1e-9))
    best = beginnings.mean[np.argmax(beginnings.weights())]
    assert abs(best - true) < 4e-4
