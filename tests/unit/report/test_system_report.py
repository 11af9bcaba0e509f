"""Figures of a system with its own tables."""

from types import SimpleNamespace

import numpy as np
import pytest

from palmd.report.series import TopicSeries
from palmd.report.system_report import truth_of


def test_the_true_angle_is_drawn_from_the_estimates_zero_of_each_object():
    t, true_t = np.linspace(0.0, 10.0, 1001), np.linspace(0.0, 10.0, 301)
    number, true = np.where(t < 5.0, 1.0, 2.0), 0.3 * true_t
    off = np.where(t < 5.0, 0.7, -2.0)
    estimate = TopicSeries(t, {"object": number, "valid": np.ones(1001), "psi_rad": 0.3 * t + off, "v1_m": t})
    truth = TopicSeries(true_t, {"psi_rad": true, "v1_m": true_t})
    series = SimpleNamespace(estimate=estimate, truth=truth, valid=np.ones(1001, dtype=bool))
    assert truth_of(series, "psi_rad") == pytest.approx(true + np.where(true_t < 5.0, 0.7, -2.0))
    assert truth_of(series, "v1_m") == pytest.approx(true_t)
