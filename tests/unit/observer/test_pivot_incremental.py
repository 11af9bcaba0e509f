"""The smoother of a slide: readings before the set-down are discarded, and an outline must be found twice."""

from dataclasses import replace

import numpy as np
import pytest

from palmd.events import PadSample, PalmSample
from palmd.observer.outline import directions
from palmd.observer.pivot import incremental
from palmd.observer.pivot.incremental import AGREE_S, IncrementalPivotSmoother, to_log_event
from palmd.observer.pivot.reconstruct import PivotReconstruction
from palmd.system.pivot import PivotRig
from palmd.system.reasons import NO_REASON, Code

SLIDE = PivotRig(vertical="float", carriage_mass=0.05)
THETA = directions()
ROUND = 0.02 + 1e-3 * np.cos(2 * THETA)
OTHER = ROUND + 4e-4 * np.cos(3 * THETA)
FOUND = replace(
    PivotReconstruction(True, NO_REASON), h=ROUND, h_sd=np.full(360, 1e-5), touched=np.ones(360, dtype=bool),
    outline_sd_m=1e-5, p=np.zeros(33), covariance=np.eye(33), t=np.array([1.0]), psi=np.array([0.0]),
)  # fmt: skip


def contact_readings(begin, end):
    return [PadSample(t, 1, 0.02, 1.0) for t in np.arange(begin, end, 0.01)]


@pytest.fixture
def smoother(monkeypatch):
    """Returns `smoother.finds` and records its input."""
    smoother = IncrementalPivotSmoother(SLIDE)
    smoother.finds, smoother.given = FOUND, []

    def found(events, rig):
        assert rig is SLIDE
        smoother.given = list(events)
        return smoother.finds

    monkeypatch.setattr(incremental, "reconstruct", found)
    return smoother


def test_an_outline_is_accepted_when_more_readings_confirm_it(smoother):
    smoother.add(contact_readings(0.0, 4.0))
    assert smoother.answer().reason_code == Code.UNCONFIRMED
    smoother.add(contact_readings(4.0, 4.0 + AGREE_S / 2))
    assert not smoother.answer().accepted
    smoother.add(contact_readings(4.0 + AGREE_S / 2, 4.1 + AGREE_S))
    assert smoother.answer().accepted


def test_answers_that_take_long_are_far_enough_apart_to_confirm(smoother):
    period = smoother.period_s
    assert period < AGREE_S
    smoother.finds = replace(FOUND, seconds=2.0 * period)
    smoother.add(contact_readings(0.0, 4.0))
    smoother.answer()
    assert smoother.period_s > AGREE_S


def test_another_outline_restarts_the_confirmation(smoother):
    smoother.add(contact_readings(0.0, 4.0))
    smoother.answer()
    smoother.finds = replace(FOUND, h=OTHER)
    smoother.add(contact_readings(4.0, 9.0))
    assert not smoother.answer().accepted
    smoother.finds = replace(FOUND, h=np.roll(OTHER, 30))  # the same outline with another starting angle
    smoother.add(contact_readings(9.0, 14.0))
    assert smoother.answer().accepted


def test_readings_before_the_set_down_are_discarded(smoother):
    smoother.add([*contact_readings(0.0, 5.0), *contact_readings(6.0, 10.0)])
    smoother.answer()
    assert smoother.given[0].t_sample == 6.0


def test_a_body_at_rest_keeps_its_outline(smoother):
    def arm(begin, end, speed):
        return [PalmSample(t, (0.01 + speed * (t - begin), 0.03)) for t in np.arange(begin, end, 0.02)]

    smoother.add([*contact_readings(0.0, 4.0), *arm(0.0, 4.0, 0.005)])
    assert smoother.answer() is not None
    smoother.add([*contact_readings(4.0, 30.0), *arm(4.0, 30.0, 0.0)])
    assert smoother.answer() is None
    smoother.add([*contact_readings(30.0, 32.0), *arm(30.0, 32.0, 0.005)])
    assert smoother.answer() is not None


def test_the_stops_height_is_not_used_as_the_pivots():
    sample = PalmSample(1.0, (0.02, 0.03), (0.01, -0.02), (0.1, 0.2))
    assert (to_log_event(sample, slides=False).vz, to_log_event(sample, slides=True).vz) == (-0.02, None)
    assert to_log_event(sample, slides=True).vx == 0.01
