"""The longest part of a record without missing data."""

import math
import random
from itertools import pairwise

import pytest

from palmd.events import PadLift, PadSample, PalmSample
from palmd.observer.data_segment import ARM_GAP_S, LEAD_S, PAD_GAP_S, DataSegment, longest_segment


def run(start=0.0, end=3.0, without=()):
    """All three sources report every 10 ms except in `without`, which holds (source, from, to)."""
    events = []
    for k in range(round(start * 100), round(end * 100) + 1):
        t = k / 100
        silent = {source for source, first, last in without if first < t < last}
        if "arm" not in silent:
            events.append(PalmSample(t, (0.7 + 0.1 * t, 1.6)))
        events += [PadSample(t, pad, 0.02 + 0.001 * t) for pad in (1, 2) if pad not in silent]
    return events


def span(events):
    found = longest_segment(events)
    return found and (found.start, found.end)


def test_a_complete_record_is_one_segment():
    events = run()
    found = longest_segment(events)
    assert (found.start, found.end) == (0.0, 3.0)
    assert len(found.pads) + len(found.palms) == len(found.events()) == len(events)


@pytest.mark.parametrize("source", [1, 2, "arm"])
def test_a_silence_of_one_source_ends_the_segment_until_all_report_again(source):
    assert span(run(without=[(source, 0.5, 1.5)])) == (1.5, 3.0)
    assert span(run(without=[(source, 1.5, 2.5)])) == (0.0, 1.5)


@pytest.mark.parametrize(("source", "limit"), [(1, PAD_GAP_S), (2, PAD_GAP_S), ("arm", ARM_GAP_S)])
def test_a_short_silence_does_not_end_the_segment(source, limit):
    assert span(run(without=[(source, 1.0, 1.0 + limit - 0.02)])) == (0.0, 3.0)


def test_steady_since_is_half_a_second_after_the_last_arm_silence():
    assert longest_segment(run()).steady_since == 0.0
    assert longest_segment(run(without=[("arm", 0.5, 0.61), ("arm", 1.0, 1.07), (1, 2.0, 2.3)])).steady_since == 1.57
    assert longest_segment(run(without=[("arm", 1.0, 1.05)])).steady_since == 0.0
    # an arm polled ten times a second
    polled = [each for k, each in enumerate(run()) if not isinstance(each, PalmSample) or k % 10 == 0]
    assert longest_segment(polled).steady_since == longest_segment(polled).start


def test_a_later_part_includes_the_arms_reports_just_before_it():
    later = longest_segment(run()).since(2.0)
    assert (later.start, later.end) == (2.0, 3.0)
    assert min(sample.t_sample for sample in later.pads) == 2.0
    assert min(sample.t_sample for sample in later.palms) == pytest.approx(2.0 - LEAD_S, abs=0.011)


def test_it_spans_the_time_with_all_sources():
    assert span(run(without=[(1, -1.0, 0.5), ("arm", 2.8, 4.0)])) == (0.5, 2.8)
    found = longest_segment(run(without=[(1, -1.0, 0.5)]))
    assert all(sample.t_sample >= 0.5 for sample in found.pads)
    assert found.palms[0].t_sample == 0.0  # earlier reports help to determine the palms' motion


def test_a_lift_from_a_palm_ends_the_segment():
    assert span([*run(), PadLift(1.004, 2)]) == (1.01, 3.0)


@pytest.mark.parametrize("missing", [PalmSample, 1, 2])
def test_without_one_source_there_is_no_segment(missing):
    left = [e for e in run() if not (isinstance(e, PalmSample) if missing is PalmSample else pad_of(e) == missing)]
    assert longest_segment(left) is None


def pad_of(event):
    return event.pad if isinstance(event, PadSample) else 0


@pytest.mark.parametrize("events", [[], run()[:1], run()[1:2], [PadLift(0.0, 1)]])
def test_almost_no_events_give_no_segment(events):
    assert longest_segment(events) is None


def test_order_and_repetition_of_events_do_not_matter():
    events = [*run(), PadSample(1.0, 1, 0.05), PalmSample(1.0, (0.9, 1.7))]  # two that contradict others
    wanted = longest_segment(events)
    twice = [event for event in events for _ in range(2)]
    for mixed in (events[::-1], twice, random.Random(0).sample(events, len(events))):
        assert longest_segment(mixed) == wanted
    for samples in ([s for s in wanted.pads if s.pad == 1], [s for s in wanted.pads if s.pad == 2], wanted.palms):
        assert all(a.t_sample < b.t_sample for a, b in pairwise(samples))


@pytest.mark.parametrize("rate", [0.02, -0.02])
def test_readings_with_the_same_time_stamp_are_averaged(rate):
    """Taking the smallest one would give an error that depends on the direction of motion."""
    palms = [PalmSample(0.016 * k, (0.7, 1.6)) for k in range(101)]
    ages = (0.010, 0.004)
    pads = [
        PadSample(palm.t_sample, pad, 0.03 + rate * (palm.t_sample - age), 1.0 + age)
        for palm in palms for pad in (1, 2) for age in ages
    ]  # fmt: skip
    for reading in longest_segment([*palms, *pads]).pads:
        assert reading.s == pytest.approx(0.03 + rate * (reading.t_sample - 0.007), abs=1e-12)
        assert reading.force == pytest.approx(1.007)


def test_non_finite_events_are_ignored():
    bad = [PadSample(1.004, 1, math.nan), PadSample(math.nan, 1, 0.02), PalmSample(1.004, (math.inf, 1.6))]
    bad += [PalmSample(1.004, (0.7, 1.6), (math.nan, 0.0)), PalmSample(1.004, (0.7, 1.6), None, (math.inf, 0.0))]
    assert longest_segment([*bad, *run()]) == longest_segment(run())


def test_most_forces_are_each_pads_largest_reading():
    """Beyond its scale a pad gives no force, which does not count as the maximum."""
    forces = [(1, 0.5), (1, 2.5), (1, None), (2, None)]
    pads = tuple(PadSample(0.01 * k, pad, 0.02, force) for k, (pad, force) in enumerate(forces))
    assert DataSegment(0.0, 0.1, pads, ()).most_forces == (2.5, 0.0)
