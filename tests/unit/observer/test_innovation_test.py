"""A failed innovation test temporarily widens published standard deviations and no internal ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated import simulated

from palmd import observer
from palmd.events import PadSample, PalmSample
from palmd.observer.bank_observer import BankObserver
from palmd.observer.forgetting import HIGH_NIS
from palmd.observer.track import DECAY_S, InnovationTest


def test_the_factor_follows_the_worst_recent_nis_and_decays() -> None:
    innovation_test = InnovationTest()
    innovation_test.take(HIGH_NIS - 0.1, 1.0)
    assert innovation_test.factor == 1.0
    innovation_test.take(HIGH_NIS + 0.5, 2.0)
    worst = innovation_test.factor
    assert worst > 3.0
    innovation_test.take(1.0, 2.0 + DECAY_S)
    assert innovation_test.factor - 1.0 == pytest.approx((worst - 1.0) / math.e)
    innovation_test.take(math.nan, 2.0 + 2.0 * DECAY_S)
    assert 1.0 < innovation_test.factor < worst
    innovation_test.take(1e9, 9.0)
    assert innovation_test.factor < 20.0


def _watched(mean_nis: float) -> BankObserver:
    """An observer after 4 s of a run, with its filters' mean NIS then set."""
    run = simulated("nominal", 107, 6.0)
    watcher, tick = observer.make("shape", run.rig), 0.01
    for event in run.events:
        if not isinstance(event, PadSample | PalmSample) or event.t_sample >= 4.0:
            continue
        while tick < event.t_sample:
            watcher.estimate(tick)
            tick += 0.01
        watcher.feed(event)
    watcher._fusion.bank.nis[:] = mean_nis
    return watcher


def test_it_widens_published_sds_and_not_the_planning_belief() -> None:
    calm, high_nis = _watched(1.0), _watched(1.9)
    before, after = calm.estimate(4.0), high_nis.estimate(4.0)
    assert before.valid
    assert after.valid
    assert after.r1 == before.r1
    assert after.sd["r1"] == pytest.approx(5.0 * before.sd["r1"])
    shapes = calm.shape(4.0), high_nis.shape(4.0)
    assert None not in shapes
    assert np.allclose(shapes[1].h_sd, 5.0 * shapes[0].h_sd)
    beliefs = calm.planning_belief(4.0), high_nis.planning_belief(4.0)
    assert None not in beliefs
    assert (beliefs[1].h_sd == beliefs[0].h_sd).all()
    assert (beliefs[1].states == beliefs[0].states).all()
    assert high_nis.estimate(4.005).valid
