"""Input that does not determine a pivoting body's outline: reported live, and no shape is accepted.

`test_pivot_reconstruct` tests the rejection of whole logs.
"""

from dataclasses import replace

import pytest
from system_logs import log_of

from palmd.events import PadLift, PadSample
from palmd.observer.pivot.incremental import SimulatedSmoothing, as_fed
from palmd.observer.pivot.live import PivotObserver
from palmd.observer.pivot.reconstruct import reconstruct
from palmd.record.systems.pivot import SYSTEM
from palmd.system.pivot import PAD, GripperSample
from palmd.system.reasons import Code
from tools.studies.pivot_logs import simulate_pivot_log

SEED = 3
TICK_S, PERIOD_S = 0.05, 4.0


@pytest.fixture(scope="module")
def good():
    log = log_of(SYSTEM, simulate_pivot_log("tilt", SEED)[0])
    return log.rig, list(log.events)


def arms(events, **changes):
    """The same readings with other reports of the arm's place."""
    return [
        replace(each, **{name: change(each) for name, change in changes.items()})
        if isinstance(each, GripperSample)
        else each
        for each in events
    ]


def one_branch(events):
    return [each for each in events if each.t_sample < 5.4]


def constant_height(events):
    return arms(events, z=lambda _: 0.02, vz=lambda _: 0.0, az=lambda _: 0.0)


def mirrored_height(events):
    return arms(events, z=lambda arm: 0.045 - arm.z, vz=lambda arm: -arm.vz, az=lambda arm: -arm.az)


def below_the_pad(events):
    return arms(events, z=lambda arm: arm.z - 0.03)


def outside_the_body(events):
    lowest = min(each.z for each in events if isinstance(each, GripperSample))
    return arms(events, z=lambda arm: arm.z - lowest + 1e-4)


class Finished:
    """A smoother whose only answer is ready."""

    def __init__(self, answer):
        self._answers = [answer]

    def submit(self, *_):
        pass

    def collect(self, _):
        return self._answers.pop() if self._answers else None


CASES = [
    (one_branch, Code.ONE_SIDE),
    (constant_height, Code.UNDETERMINED),
    (mirrored_height, Code.UNEXPLAINED),
    (below_the_pad, Code.PIVOT_MISPLACED),
    (outside_the_body, Code.PIVOT_MISPLACED),
]
NAMES = [case[0].__name__ for case in CASES]


def test_a_whole_log_with_the_pivot_outside_the_body_is_rejected(good):
    rig, events = good
    answer = reconstruct(outside_the_body(events), rig)
    assert not answer.converged
    assert answer.h is answer.h_sd is answer.touched is None
    assert answer.reason.code == Code.PIVOT_MISPLACED


@pytest.mark.nightly
@pytest.mark.parametrize(("corrupt", "code"), CASES, ids=NAMES)
def test_live_the_reason_is_given_and_no_shape_is_accepted(good, corrupt, code):
    rig, events = good
    live = PivotObserver(rig, SimulatedSmoothing(rig, PERIOD_S))
    waiting = sorted(corrupt(events), key=lambda event: event.t_sample)
    codes = set()
    for tick in range(1, round((waiting[-1].t_sample + 1.0) / TICK_S)):
        t = tick * TICK_S
        while waiting and waiting[0].t_sample <= t:
            live.feed(as_fed(waiting.pop(0)))
        live.improve(t)
        estimate = live.estimate(t)
        assert not estimate.valid
        assert live.shape(t) is None
        codes.update(estimate.invalid_reasons)
    assert code in codes


def test_good_input_is_accepted_live(good):
    rig, events = good
    live = PivotObserver(rig, SimulatedSmoothing(rig, PERIOD_S))
    last = events[-1].t_sample
    for event in events:
        live.feed(as_fed(event))
        if isinstance(event, PadSample) and event.t_sample > last - 0.1:
            live.improve(event.t_sample)
    answer = live.improve(last + 1.0)
    assert live.shape(last) is not None
    newest = [each for each in events if isinstance(each, PadSample)][-1]
    live.feed(PadLift(last + 0.01, PAD))
    assert live.estimate(last + 0.01).invalid_reasons == (Code.UNTOUCHED,)
    live.feed(replace(newest, t_sample=last + 0.02))
    assert live.estimate(last + 0.02).invalid_reasons == (Code.ORIENTATION_UNKNOWN,)
    for more_sd, codes in ((0.0, ()), (1e-3, (Code.UNEXPLORED,))):
        another = PivotObserver(rig, Finished(replace(answer, h_sd=answer.h_sd + more_sd)))
        for event in events:
            another.feed(as_fed(event))
        another.improve(last)
        assert another.estimate(last).invalid_reasons == codes
