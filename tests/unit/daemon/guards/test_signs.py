"""Wrong signs of pads are detected from how contacts move while the palms open and close."""

import math

import numpy as np
import pytest

from palmd.daemon.guards.signs import SignWatch
from palmd.events import PadSample, PalmMotion
from palmd.rig.shapes import random_body

ZERO, MIDDLE = 0.028, 0.02775
STRIP_ZERO = 0.0555


def watched(signs, seed, seconds=6.0, zero=ZERO):
    """An eccentric round body between palms that open and close by 8°, read with these signs by pads with that zero."""
    rng = np.random.default_rng(seed)
    r1, r2 = rng.uniform(0.014, 0.026, 2)
    off, phase = rng.uniform(0.0, 0.004), rng.uniform(0.0, math.tau)
    watch = SignWatch((zero, zero), (MIDDLE, MIDDLE))
    t_named = None
    for n in range(round(seconds * 100)):
        t = 0.01 * n
        opening = math.radians(92.0 + 8.0 * math.sin(math.tau * 0.4 * t))
        rate = math.radians(8.0) * math.tau * 0.4 * math.cos(math.tau * 0.4 * t)
        turn = phase + 1.5 * math.sin(math.tau * 0.31 * t)
        a, b = r1 + off * math.cos(turn), r2 + off * math.cos(turn + opening)
        s1 = (b + a * math.cos(opening)) / math.sin(opening) + off * math.sin(turn)
        s2 = (a + b * math.cos(opening)) / math.sin(opening) - off * math.sin(turn + opening)
        for pad, (s, sign) in enumerate(zip((s1, s2), signs, strict=True), 1):
            read = s if sign > 0 else 2.0 * (ZERO if zero == ZERO else MIDDLE) - s + 1e-3 * pad
            watch.feed(PadSample(t, pad, read + float(rng.normal(0.0, 1e-4))))
        watch.look(t, PalmMotion((0.8, opening), (0.0, rate), (0.0, 0.0)))
        if watch.wrong and t_named is None:
            t_named = t
    return watch, t_named


@pytest.mark.parametrize("zero", [ZERO, STRIP_ZERO])
@pytest.mark.parametrize("seed", range(12))
def test_two_wrong_signs_are_detected_within_five_seconds(seed, zero):
    watch, t_named = watched((-1, -1), seed, zero=zero)
    assert watch.wrong == (1, 2)
    assert t_named <= 5.0


@pytest.mark.parametrize("zero", [ZERO, STRIP_ZERO, -0.0015])
@pytest.mark.parametrize("seed", range(12))
def test_correct_signs_are_never_reported(seed, zero):
    watch, t_named = watched((1, 1), seed, 20.0, zero=zero)
    assert watch.wrong == ()
    assert t_named is None


@pytest.mark.parametrize("seed", [1, 4, 7, 11, 16, 21, 34, 84])
def test_right_signs_are_not_doubted_for_an_outline_that_turns_slowly(seed):
    """Random outlines, at openings from 50 to 130°, whose contacts move by the outline as much as by the opening."""
    rng = np.random.default_rng(seed)
    support = random_body("rig", rng).support
    grid = np.linspace(0.0, math.tau, 720, endpoint=False)
    heights = support.sample(grid)
    slopes = (np.roll(heights, -1) - np.roll(heights, 1)) / (2.0 * grid[1])
    watch = SignWatch((0.0025, 0.0025), (0.03125, 0.03125))
    mean, swing = math.radians(rng.uniform(75.0, 105.0)), math.radians(rng.uniform(3.0, 25.0))
    pace, phase, turn = math.tau * rng.uniform(0.2, 0.6), rng.uniform(0.0, math.tau), 0.0
    for n in range(400):
        t = 0.05 * n
        if n % 20 == 0:
            turning = rng.normal(0.0, 0.3)
        turn += 0.05 * turning
        opening = mean + swing * math.sin(pace * t + phase)
        rate = swing * pace * math.cos(pace * t + phase)
        (r1, d1), (r2, d2) = (
            [np.interp(angle % math.tau, grid, values, period=math.tau) for values in (heights, slopes)]
            for angle in (-turn, opening + math.pi - turn)
        )
        s1 = (r2 + r1 * math.cos(opening)) / math.sin(opening) + d1
        s2 = (r1 + r2 * math.cos(opening)) / math.sin(opening) - d2
        for pad, s in enumerate((s1, s2), 1):
            watch.feed(PadSample(t, pad, s + float(rng.normal(0.0, 1.5e-4))))
        watch.look(t, PalmMotion((0.8, opening), (0.0, rate), (0.0, 0.0)))
        assert watch.wrong == ()
