"""What surprised a filter widens what is published, for a while, and nothing that is acted on."""

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


def test_the_worst_of_late_counts_and_fades() -> None:
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


def _watched(surprised_with: float) -> BankObserver:
    """An observer that has watched a run for 4 s, whose filters' mean NIS is then set."""
    run = simulated("nominal", 107, 6.0)
    watcher, tick = observer.make("shape", run.rig), 0.01
    for event in run.events:
        if not isinstance(event, PadSample | PalmSample) or event.t_sample >= 4.0:
            continue
        while tick < event.t_sample:
            watcher.estimate(tick)
            tick += 0.01
        watcher.feed(event)
    watcher._fusion.bank.nis[:] = surprised_with
    return watcher


def test_it_widens_what_is_told_and_nothing_that_is_acted_on() -> None:
    calm, surprised = _watched(1.0), _watched(1.9)
    before, after = calm.estimate(4.0), surprised.estimate(4.0)
    assert before.valid
    assert after.valid
    assert after.r1 == before.r1
    assert after.sd["r1"] == pytest.approx(5.0 * before.sd["r1"])
    shapes = calm.shape(4.0), surprised.shape(4.0)
    assert None not in shapes
    assert np.allclose(shapes[1].h_sd, 5.0 * shapes[0].h_sd)
    outlooks = calm.planning_belief(4.0), surprised.planning_belief(4.0)
    assert None not in outlooks
    assert (outlooks[1].h_sd == outlooks[0].h_sd).all()
    assert (outlooks[1].states == outlooks[0].states).all()
    assert surprised.estimate(4.005).valid
