"""Common error of a pad's forces, and how an arm follows its plan."""

from dataclasses import replace

import numpy as np
import pytest

from palmd.observer.force_gain import DRIFT_S, HYSTERESIS
from palmd.observer.pivot.arm_path import axis_path
from palmd.observer.pivot.fit import gain_modes
from palmd.observer.pivot.incremental import ACCEPTED_M, answer_of
from palmd.observer.pivot.reconstruct import PivotReconstruction, reconstruct
from palmd.observer.pivot.record import PivotRecord, Rows, TouchSpan
from palmd.system.description import PadSensor
from palmd.system.pivot import PivotRig
from palmd.system.reasons import Code, Reason

STD = 0.03


def record_of(t, force, std=STD):
    none = np.zeros(0)
    rows = Rows(t, force, np.ones(len(t)), np.zeros((len(t), 9)), np.zeros(len(t), dtype=np.intp), none)
    rig = PivotRig(pad=PadSensor(force_gain_std=std))
    return PivotRecord(rig, (TouchSpan(t[0], t[-1], 0, 10),), rows, rows, rows, rows)


def test_forces_without_a_common_gain_error_have_no_modes():
    t = np.linspace(0.0, 10.0, 100)
    assert gain_modes(record_of(t, np.ones(100), std=0.0)).shape == (100, 0)


def test_forces_near_in_time_share_their_relative_error():
    t = np.linspace(0.0, 60.0, 61)
    modes = gain_modes(record_of(t, np.ones(61)))
    covariance = modes @ modes.T
    assert covariance[0, 0] == pytest.approx(STD**2 + HYSTERESIS**2)
    assert covariance[0, 20] == pytest.approx(STD**2 * np.exp(-20.0 / DRIFT_S), rel=0.05)


def test_hysteresis_lags_behind_rising_and_falling_forces():
    t = np.linspace(0.0, 10.0, 101)
    force = 1.0 - 0.1 * np.abs(t - 5.0)
    behind = gain_modes(record_of(t, force), force)[:, -1]
    assert behind[:50] == pytest.approx(-HYSTERESIS)
    assert behind[-40:] == pytest.approx(HYSTERESIS)


def test_an_arms_lag_and_smoothing_are_identified():
    t = np.arange(0.0, 20.0, 0.016)
    x, v, a = 0.02 + 1e-3 * np.sin(12 * t), 1.2e-2 * np.cos(12 * t), -0.144 * np.sin(12 * t)
    lag, rounding = 2e-3, 1e-4
    true = x - lag * v + rounding * a
    noise = 1.5e-5
    measured = true + np.random.default_rng(0).normal(0.0, noise, len(t))
    path = axis_path(t, measured, list(v), list(a), noise)
    middle = t[100:-100]
    assert np.abs(path.at(middle)[0] - true[100:-100]).max() < 6e-6
    true_v = v - lag * a + rounding * -1.728 * np.cos(12 * t)
    assert np.abs(path.at(middle)[1] - true_v[100:-100]).max() < 3e-5


def test_an_outline_with_a_large_sd_is_not_accepted_live():
    found = replace(reconstruct((), PivotRig()), converged=True, outline_sd_m=2.0 * ACCEPTED_M)
    answer = answer_of(found, 1.0)
    assert not answer.accepted
    assert (answer.reason, answer.reason_code) == (
        "the outline's standard deviation is 0.10 mm; 0.05 mm is accepted", Code.NOT_SHARP
    )  # fmt: skip
    assert not answer_of(PivotReconstruction(False, Reason(Code.OTHER, "why")), 1.0).accepted
