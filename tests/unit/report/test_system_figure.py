"""What is drawn of a system with tables of its own."""

from dataclasses import dataclass

import numpy as np
import pytest

from palmd.report.system_figure import truth_of


@dataclass
class Table:
    t: np.ndarray
    columns: dict

    def __getitem__(self, name):
        return self.columns[name]


@dataclass
class Drawn:
    estimate: Table
    truth: Table

    @property
    def valid(self):
        return self.estimate["valid"] > 0.5


def test_the_true_angle_is_drawn_from_the_estimates_zero_of_each_object():
    t, true_t = np.linspace(0.0, 10.0, 1001), np.linspace(0.0, 10.0, 301)
    number, true = np.where(t < 5.0, 1.0, 2.0), 0.3 * true_t
    off = np.where(t < 5.0, 0.7, -2.0)
    estimate = Table(t, {"object": number, "valid": np.ones(1001), "psi_rad": 0.3 * t + off, "v1_m": t})
    series = Drawn(estimate, Table(true_t, {"psi_rad": true, "v1_m": true_t}))
    assert truth_of(series, "psi_rad") == pytest.approx(true + np.where(true_t < 5.0, 0.7, -2.0))
    assert truth_of(series, "v1_m") == pytest.approx(true_t)
