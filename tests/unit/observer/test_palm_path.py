"""The palms' motion smoothed over a whole record, against the true motion."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plain_palm_path import smoothed_plainly

from palmd.events import PalmSample
from palmd.observer import palm_path
from palmd.observer.palm_path import PalmPath, smoothed_path
from palmd.rig.simulate import Rock, Rocking

NOISE = 2e-4
ROCKING = Rocking(Rock(0.75, 0.6, 0.35, 1.0), Rock(1.65, 0.25, 0.4, -2.0))
MEANWHILE = np.arange(0.0, 5.98, 0.005)


def reports(noise=NOISE, seed=0):
    random = np.random.default_rng(seed)
    for k in range(375):
        t = 0.016 * k
        plan = ROCKING.at(t)
        phi1, phi2 = plan.angles + noise * random.standard_normal(2)
        yield PalmSample(t, (phi1, phi2), plan.rates, plan.accelerations)


def true_motion(times):
    plans = [ROCKING.at(t) for t in times]
    return np.array([[*p.angles, *p.rates, *p.accelerations] for p in plans])


def without_plan(sample, rates=False):
    plan = {} if rates else {"rates": None}
    return replace(sample, accelerations=None, **plan)


@pytest.mark.parametrize(
    ("known", "angle", "rate", "acceleration"),
    [
        (lambda sample: sample, 5e-5, 5e-4, 1e-2),
        (lambda sample: without_plan(sample, rates=True), 6e-5, 1.2e-3, 0.2),
        (without_plan, 1.6e-4, 1e-2, 0.8),
    ],
    ids=["with plan", "with rates", "angles only"],
)
def test_the_smoothed_motion_is_more_accurate_than_the_reports(known, angle, rate, acceleration):
    error = smoothed_path([known(sample) for sample in reports()], NOISE).at(MEANWHILE) - true_motion(MEANWHILE)
    easing_in = MEANWHILE < 1.2  # where the plan's jerk is greatest
    for part in (error[easing_in], error[~easing_in]):
        rms = np.sqrt(np.mean(part.reshape(-1, 3, 2) ** 2, axis=(0, 2)))
        assert (rms < [angle, rate, acceleration]).all(), rms


def test_a_gap_is_bridged_by_a_quintic():
    kept = [sample for sample in reports() if not 2.0 < sample.t_sample < 2.29]
    error = smoothed_path(kept, NOISE).at(MEANWHILE) - true_motion(MEANWHILE)
    assert np.abs(error[:, :2]).max() < 2.5e-4


def test_angle_rate_and_acceleration_are_consistent_between_reports():
    path = smoothed_path(list(reports()), NOISE)
    t, step = np.array([1.003, 2.5, 3.333]), 1e-5
    before, at, after = path.at(t - step), path.at(t), path.at(t + step)
    slope = (after - before) / (2 * step)
    assert slope[:, :2] == pytest.approx(at[:, 2:4], abs=1e-8)
    assert slope[:, 2:4] == pytest.approx(at[:, 4:], abs=1e-6)


def test_at_the_reports_the_path_equals_the_smoothed_state():
    path = smoothed_path(list(reports()), NOISE)
    assert path.at(path.t) == pytest.approx(path.state.reshape(-1, 6), abs=1e-9)


def test_outside_the_reports_the_acceleration_is_constant():
    path = PalmPath(np.array([1.0]), np.array([[[0.7, 1.6], [0.2, -0.1], [2.0, 0.0]]]))
    (at,) = path.at(np.array([1.5]))
    assert at == pytest.approx([0.7 + 0.1 + 0.25, 1.6 - 0.05, 1.2, -0.1, 2.0, 0.0])


def test_one_report_is_sufficient_and_none_is_refused():
    (at,) = smoothed_path([PalmSample(0.0, (0.7, 1.6))], NOISE).at(np.array([0.0]))
    assert at[:2] == pytest.approx([0.7, 1.6], abs=1e-6)
    assert math.hypot(*at[2:]) == 0.0
    with pytest.raises(ValueError, match="no report"):
        smoothed_path([], NOISE)


def irregular(samples):
    """Reports at irregular times, some without the plan's rates and accelerations."""
    forms = (lambda sample: sample, without_plan, lambda sample: without_plan(sample, rates=True))
    kept = [sample for k, sample in enumerate(samples) if k % 7 or k % 3]
    return [forms[k // 20 % 3](sample) for k, sample in enumerate(kept)]


def test_compiled_smoothing_agrees_with_numpy(monkeypatch):
    samples = irregular(list(reports()))
    got = smoothed_path(samples, NOISE).state
    monkeypatch.setattr(palm_path, "_smoothing", lambda: smoothed_plainly)
    np.testing.assert_allclose(got, smoothed_path(samples, NOISE).state, rtol=1e-9, atol=1e-10)
