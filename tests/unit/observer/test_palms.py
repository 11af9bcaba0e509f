"""The palms' motion between reports, and the consistency of its error bars."""

import math

import numpy as np
import pytest

from palmd.events import PalmSample
from palmd.motion.segments import Move
from palmd.observer.palms import PalmTracker
from palmd.system.description import RigDescription

NOISE = 2e-4
REPORT_S, ROUNDED_S = 0.016, 0.024


def planned_motion(duration, way=1.0, pause=0.2, count=12):
    """Moves to and fro with pauses: the plan's angle, rate and acceleration at any time."""
    there, back = Move((0.5, 1.5), (0.5 + way, 1.5), duration), Move((0.5 + way, 1.5), (0.5, 1.5), duration)

    def at(t):
        number, since = divmod(max(t, 0.0), duration + pause)
        return (there if int(number) % 2 == 0 else back).at(min(since, duration))

    return at, count * (duration + pause)


def normalised(duration, age=0.012, seed=3):
    """Squared errors of angle and rate over their variance, `age` after each report of palms that smooth the plan."""
    at, seconds = planned_motion(duration)
    random = np.random.default_rng(seed)

    def really(t):
        return float(np.mean([at(t + u).angles[0] for u in np.linspace(-0.5, 0.5, 25) * ROUNDED_S]))

    tracker, squares = PalmTracker(NOISE), []
    for t in np.arange(0.5, seconds, REPORT_S):
        plan = at(t)
        tracker.feed(
            PalmSample(
                t,
                (really(t) + NOISE * random.standard_normal(), 1.5),
                (plan.rates[0], 0.0),
                (plan.accelerations[0], 0.0),
            )
        )
        angle_sd, rate_sd = tracker.sd(t + age)
        guess = tracker.at(t + age)
        rate = (really(t + age + 1e-4) - really(t + age - 1e-4)) / 2e-4
        squares.append([((guess[0] - really(t + age)) / angle_sd[0]) ** 2, ((guess[2] - rate) / rate_sd[0]) ** 2])
    return np.mean(squares, axis=0)


@pytest.mark.parametrize("duration", [0.7, 1.0, 3.0])
def test_error_bars_hold_for_an_arm_that_smooths_fast_moves(duration):
    angle, rate = normalised(duration)
    assert 0.1 < angle < 3.0
    assert rate < 3.0


def test_palms_at_rest_have_the_reports_accuracy():
    tracker = PalmTracker(NOISE)
    for number in range(200):
        tracker.feed(PalmSample(number * REPORT_S, (0.5, 1.5), (0.0, 0.0), (0.0, 0.0)))
    angle_sd, rate_sd = tracker.sd(tracker.t + 0.01)
    assert angle_sd == pytest.approx([7e-5, 7e-5], abs=5e-5)
    assert (rate_sd < 5e-3).all()
    assert math.isfinite(tracker.at(tracker.t + 0.01)[0])


def test_the_variance_of_rounded_set_points_matches_their_errors():
    """Servos follow set-points in whole counts, every 10 ms, with lag: this causes rates that no report contains."""
    count, lag_s, step_s = math.tau / 4096, 0.010, 1e-3
    rig = RigDescription(goal_rounding=count)
    tracker, squares, random = PalmTracker(7e-4), [], np.random.default_rng(4)
    really = np.zeros((2, 3))  # each palm's own direction after zero, one and two lags
    for k in range(4000):
        t = k * step_s
        meant = 0.8 + 0.3 * np.sin([1.1 * t, 1.7 * t])
        if k % 10 == 0:
            really[:, 0] = np.round(meant / count) * count
        if k == 0:
            really[:] = really[:, :1]
        rates = (really[:, :-1] - really[:, 1:]) / lag_s
        really[:, 1:] += rates * step_s
        joints, turning = really[:, 2] - [0.0, really[0, 2]], rates[:, 1] - [0.0, rates[0, 1]]
        if k > 500 and k % 10 == 3:
            angle_sd, rate_sd = np.hypot(tracker.sd(t), rig.rounding_sd)
            now = tracker.at(t)
            squares.append([((now[:2] - joints) / angle_sd) ** 2, ((now[2:4] - turning) / rate_sd) ** 2])
        if k % 10 == 0:
            behind = t - 2 * lag_s - 5 * step_s  # the plan as executed
            rate = np.array([0.33 * np.cos(1.1 * behind), 0.51 * np.cos(1.7 * behind)])
            bend = np.array([-0.363 * np.sin(1.1 * behind), -0.867 * np.sin(1.7 * behind)])
            seen = joints + 7e-4 * random.standard_normal(2)
            tracker.feed(PalmSample(t, tuple(seen), *(tuple(each - [0.0, each[0]]) for each in (rate, bend))))
    angle, rate = np.mean(squares, axis=(0, 2))
    assert 0.3 < angle < 2.0
    assert 0.3 < rate < 2.0


def test_readings_count_as_repeated_while_the_palms_rest():
    tracker = PalmTracker(2e-4)
    assert tracker.repeated == 1.0
    for k in range(200):
        omega = 0.3 if k < 100 else 0.0
        tracker.feed(PalmSample(0.016 * k, (0.7 + 0.3 * 0.016 * min(k, 100), 1.6), (omega, 0.0), (0.0, 0.0)))
        if k < 100:
            assert tracker.repeated == 1.0
    assert tracker.repeated == pytest.approx(1.0 + 100 * 0.016, abs=0.3)
