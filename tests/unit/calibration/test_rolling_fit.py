"""Gravity from rolls, against rolls integrated from forces and torques, and input that contains no rolls."""

import math

import numpy as np
import pytest
from campaign import nightly
from rolls import READING_SD, rolled, standing

from palmd.calibration.rolling_fit import Roll, TooFewRollsError, accelerate, find_rolls, fit_gravity
from palmd.events import PadSample

POSES = [(1, 8.0, 110.0, 13), (1, 26.0, 110.0, 40), (2, 41.0, 110.0, 40), (2, 59.0, 110.0, 13)]


def session(rng, poses=POSES, **truth):
    """The rolls of a whole calibration, and the numbers of rejected ones."""
    good, too_short, rough = [], 0, 0
    for pad, phi1_deg, phi2_deg, count in poses:
        events, t = [standing(phi1_deg, phi2_deg)], 0.0
        for _ in range(count):
            more, t = rolled(rng, pad, phi1_deg, phi2_deg, t0=t, **truth)
            events += more
        rolls, short = find_rolls(events)
        found = [accelerate(roll, READING_SD) for roll in rolls]
        good += [each for each in found if each is not None]
        too_short, rough = too_short + short, rough + found.count(None)
    return good, too_short, rough


@pytest.mark.parametrize("seed", [0, 1, *nightly(*range(2, 10))])
def test_gravity_and_yaw_are_found_within_the_stated_tolerance(seed):
    rng = np.random.default_rng(seed)
    kind, inertia = (("ball", 0.4), ("cylinder", 0.5))[seed % 2]
    g, yaw_error = 9.81 * rng.uniform(0.6, 1.0), math.radians(rng.uniform(-3.0, 3.0))
    good, too_short, rough = session(rng, g=g, yaw_error=yaw_error, resistance=0.004, inertia=inertia)
    fit = fit_gravity(good, kind)
    assert fit.g == pytest.approx(g, rel=0.005)
    assert abs(fit.delta - yaw_error) < math.radians(0.1)
    assert abs(fit.resistance - 0.004) < 4.0 * fit.resistance_sd < 0.004
    assert abs(fit.g - g) < 4.0 * fit.g_sd
    assert 0.7 < fit.scatter < 1.3
    assert (too_short, rough) == (0, 0)
    assert fit.inconsistent <= 1


def test_detecting_a_rolls_start_biases_it_by_less_than_a_fifth_of_the_tolerance():
    good, _, _ = session(np.random.default_rng(11), [(1, 8.0, 110.0, 500)], g=9.81, yaw_error=0.0)
    true = -9.81 * (math.sin(math.radians(8.0)) - 0.003 * math.cos(math.radians(8.0))) / 1.4
    wrong = np.array([each.a / true - 1.0 for each in good])
    assert wrong.std() < 0.009
    assert abs(wrong.mean()) < 0.001  # three sigma of that mean


def test_the_wrong_roller_gives_a_wrong_gravity():
    good, _, _ = session(np.random.default_rng(1), g=9.81, yaw_error=0.01)
    assert fit_gravity(good, "cylinder").g == pytest.approx(9.81 * 15 / 14, rel=0.01)


def test_a_pushed_or_slipping_roll_is_excluded_and_counted():
    rng = np.random.default_rng(2)
    good, _, _ = session(rng, g=9.81, yaw_error=0.0)
    slid, _, _ = session(rng, [(1, 26.0, 110.0, 3)], g=9.81, yaw_error=0.0, inertia=0.0)
    fit = fit_gravity([*good, *slid], "ball")
    assert fit.inconsistent == 3
    assert fit.g == pytest.approx(9.81, rel=0.005)


def test_outliers_of_a_roll_are_excluded():
    rng = np.random.default_rng(3)
    events, _ = rolled(rng, 1, 15.0, 110.0, 9.81, 0.0)
    ((clean,), _) = find_rolls([standing(15.0, 110.0), *events])
    s = clean.s.copy()
    s[-5] += 2e-3
    s[-9] -= 2e-3
    corrupted = accelerate(Roll(1, clean.phi, clean.rest, clean.t, s), READING_SD)
    unspoilt = accelerate(clean, READING_SD)
    assert corrupted.left_out == unspoilt.left_out + 2
    assert corrupted.a == pytest.approx(unspoilt.a, rel=0.02)


def reported(times, places, pad=1):
    return [
        standing(10.0, 110.0),
        *(PadSample(float(t), pad, float(s), 0.3) for t, s in zip(times, places, strict=True)),
    ]


T = np.arange(0.0, 1.0, 0.01)


@pytest.mark.parametrize(
    ("places", "short"),
    [
        (np.full_like(T, 0.05), 0),  # at rest
        (0.01 + 0.04 * T, 0),  # upwards
        (0.05 - 0.01 * T, 1),  # not far enough
    ],
)
def test_motion_other_than_rolling_down_is_not_a_roll(places, short):
    assert find_rolls(reported(T, places)) == ([], short)


def test_a_roller_guided_by_hand_is_rejected():
    led = 0.045 - 0.03 * T - 0.004 * np.sin(7.0 * T)
    rolls, _ = find_rolls(reported(T, led))
    assert len(rolls) == 1
    assert accelerate(rolls[0], READING_SD) is None


def test_a_roll_ends_at_the_pads_end():
    fall = 0.052 - 0.5 * np.clip(T - 0.1, 0.0, None) ** 2
    events = reported(T, fall)
    met = sorted([*events, PadSample(0.325, 2, 0.01, 0.1)], key=lambda event: event.t_sample)
    ((whole,), _), ((part,), _) = find_rolls(events), find_rolls(met)
    assert whole.t[-1] > 0.36
    assert part.t[-1] == pytest.approx(0.32)


def test_silence_ends_a_roll_and_palm_angles_are_required():
    times = T[:32]
    fall = 0.052 - 0.5 * np.clip(times - 0.1, 0.0, None) ** 2
    late = np.where(times > 0.245, times + 0.2, times)
    assert len(find_rolls(reported(times, fall))[0]) == 1
    assert find_rolls(reported(late, fall))[0] == []
    assert find_rolls(reported(times, fall)[1:]) == ([], 0)


def test_too_few_rolls_or_slopes_are_refused_with_what_is_missing():
    rng = np.random.default_rng(4)
    truth = {"g": 9.81, "yaw_error": 0.0}
    with pytest.raises(TooFewRollsError, match="0 of at least 4 good rolls on palm 1"):
        fit_gravity([], "ball")
    good, _, _ = session(rng, POSES[:2], **truth)
    with pytest.raises(TooFewRollsError, match="0 of at least 4 good rolls on palm 2"):
        fit_gravity(good, "ball")
    good, _, _ = session(rng, [(1, 8.0, 110.0, 5), (2, 59.0, 110.0, 5)], **truth)
    with pytest.raises(TooFewRollsError, match="widen the limits"):
        fit_gravity(good, "ball")
