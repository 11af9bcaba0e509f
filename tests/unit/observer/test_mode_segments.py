"""Contact-mode segments are found in the readings and grouped by side; the motion between them is left open."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from simulated import simulated

from palmd.events import FloatArray, PadSample, PalmSample
from palmd.model import smoothing
from palmd.model.smoothing import C
from palmd.observer.data_segment import longest_segment
from palmd.observer.mode_segments import ModeSegment, find_mode_segments, group_by_mode
from palmd.observer.normal_equations import Guess, ProcessNoise, Residuals
from palmd.observer.palm_path import smoothed_path
from palmd.observer.record import Record, lay_out
from palmd.observer.search import Search
from palmd.system.description import RigDescription

HIGH, RHO = 0.016, 0.002
TIPS = (2.0, 2.6)  # s
END = 5.0


def opening(t: FloatArray) -> FloatArray:
    return 1.6 + 0.2 * np.sin(2.0 * t)


def laid(on_one: FloatArray, on_other_palm: FloatArray, t: FloatArray) -> Record:
    """Readings of palm 1 and 2 at the same times, with noise."""
    rig, random = RigDescription(hinge="fixed"), np.random.default_rng(5)
    palms = [
        PalmSample(
            float(at), (0.7, float(opening(at))), (0.0, 0.4 * math.cos(2.0 * at)), (0.0, -0.8 * math.sin(2 * at))
        )
        for at in np.arange(0.0, END, 0.016)
    ]
    samples = [
        PadSample(float(at), pad, float(s + random.normal(0.0, 1e-4)), 1.0)
        for at, *both in zip(t, on_one, on_other_palm, strict=True)
        for pad, s in enumerate(both, 1)
    ]
    return lay_out(samples, smoothed_path(palms, 2e-4), rig, 0.0, END, 0.005)


def by_corner(t: FloatArray) -> FloatArray:
    return (HIGH + RHO * np.cos(opening(t))) / np.sin(opening(t))


def test_two_segments_on_one_side_are_found_without_the_tip_between():
    t = np.arange(0.0, END, 0.012)
    tips = (t > TIPS[0]) & (t < TIPS[1])
    other = by_corner(t) + np.where(tips, 8e-3 * np.sin(math.pi * (t - TIPS[0]) / (TIPS[1] - TIPS[0])), 0.0)
    found = find_mode_segments(laid(0.02 + 4e-3 * np.sin(9.0 * t), other, t))
    on_first = [segment for segment in found if segment.palm == 0]
    assert len(on_first) == 2
    for segment, (start, end) in zip(
        sorted(on_first, key=lambda segment: segment.start), [(0.0, 2.0), (2.6, END)], strict=True
    ):
        assert (segment.start, segment.end) == pytest.approx((start, end), abs=0.06)
        assert segment.excludes_disc
        sd = np.sqrt(np.diagonal(segment.covariance))
        assert np.abs(segment.corner - (HIGH, RHO)) == pytest.approx(np.zeros(2), abs=4 * float(sd.max()))
    assert [segment.start for segment in group_by_mode(found)[0]] == sorted(segment.start for segment in on_first)


def test_segments_possible_on_either_palm_do_not_exclude_a_disc():
    t = np.arange(0.0, END, 0.012)
    assert not any(segment.excludes_disc for segment in find_mode_segments(laid(by_corner(t), by_corner(t), t)))


def test_segments_with_another_corner_or_palm_are_separate_groups():
    one = ModeSegment(0, 0.0, 2.0, np.array([HIGH, RHO]), 1e-10 * np.eye(2), True)
    again = replace(one, start=3.0, end=6.0, corner=one.corner + 2e-5)
    higher, on_other = replace(one, corner=one.corner + np.array([2e-4, 0.0])), replace(one, palm=1)
    assert [len(group) for group in group_by_mode([again, one, higher, on_other])] == [2, 1, 1]
    assert group_by_mode([again, one])[0] == [one, again]


def test_the_cost_of_parts_is_their_sum_for_any_motion_between_them():
    run = simulated("friction", 3, 3.0)
    record = Search(longest_segment(run.events), run.rig).record
    spans = [(record.t[20], record.t[90]), (record.t[150], record.t[220])]
    whole = record.within(spans)
    assert whole.spans == spans
    p = np.zeros(smoothing.CONSTANTS)
    p[C.SHAPE], p[C.LN_RHO], p[C.DRAG], p[C.SATURATION] = 0.018, math.log(0.012), 10.0, 1e4
    noise = ProcessNoise(1e-6, 1e-3)
    x = np.random.default_rng(0).normal(0.0, 0.01, (len(whole.t), 2))
    x[71:, 0] += 1.0
    parts = [record.within([span]) for span in spans]
    for each in (noise, replace(noise, gate=4.0)):
        costs = [
            Residuals(smoothing.library(), part).linearised(Guess(nodes, p), each)
            for part, nodes in zip(parts, (x[:71], x[71:]), strict=True)
        ]
        both = Residuals(smoothing.library(), whole).linearised(Guess(x, p), each)
        if each.gate == math.inf:  # else it depends on the median of all readings
            assert both.cost == pytest.approx(sum(cost.cost for cost in costs), rel=1e-9)
        assert not both.banded[2:, 2 * 70 : 2 * 71].any()
    assert whole.between(60, 100).gap_steps.tolist() == [10]
