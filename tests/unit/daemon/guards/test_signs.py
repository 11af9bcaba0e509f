"""Wrong signs of pads are detected from how contacts move while the palms open and close."""

import math

import numpy as np
import pytest

from palmd.daemon.guards.signs import SignWatch
from palmd.events import PadSample, PalmMotion

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
