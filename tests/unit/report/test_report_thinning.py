"""Thinned lines keep their visible shape."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from palmd.report.axes import thinned, thinned_band, with_gaps


@given(values=arrays(np.float64, st.integers(50, 400), elements=st.floats(-1e3, 1e3)), columns=st.integers(5, 20))
def test_no_peak_is_lost_and_no_value_invented(values, columns):
    t = np.arange(len(values)) * 0.01
    t_thin, thin = thinned(t, values, columns)
    assert len(thin) <= max(3 * columns, len(values) if len(values) <= 2 * columns else 0)
    assert (thin.max(), thin.min()) == (values.max(), values.min())
    assert (np.diff(t_thin) >= 0).all()
    at = dict(zip(t.tolist(), values.tolist(), strict=True))
    assert all(at[each] == value for each, value in zip(t_thin.tolist(), thin.tolist(), strict=True))


def test_a_short_line_is_unchanged():
    t, values = np.arange(10) * 0.1, np.arange(10.0)
    t_thin, thin = thinned(t, values, 20)
    assert t_thin.tolist() == t.tolist()
    assert thin.tolist() == values.tolist()


@pytest.mark.parametrize("columns", [20, 1000])
def test_lost_messages_break_the_line(columns):
    t = np.concatenate([np.arange(200) * 0.01, 5.0 + np.arange(200) * 0.01])
    t_thin, thin = thinned(t, np.ones(400), columns)
    broken = t_thin[np.isnan(thin)]
    assert len(broken) == 1
    assert 2.0 < broken[0] < 5.0


def test_unknown_values_stay_unknown():
    values = np.ones(1000)
    values[300:500] = np.nan
    t_thin, thin = thinned(np.arange(1000) * 0.01, values, 50)
    unknown = t_thin[np.isnan(thin)]
    assert unknown.min() == pytest.approx(3.0)
    assert unknown.max() == pytest.approx(4.99, abs=0.2)
    assert np.isfinite(thin[t_thin < 2.9]).all()


def test_a_band_covers_all_values_in_its_columns():
    t = np.arange(1000) * 0.01
    low, high = -1 - np.abs(np.sin(40 * t)), 1 + np.abs(np.cos(37 * t))
    high[400:420] = low[400:420] = np.nan
    middle, least, greatest = thinned_band(t, low, high, 50)
    assert len(middle) == 50
    assert np.isnan(least).sum() == np.isnan(greatest).sum() == 1
    assert np.nanmin(least) == np.nanmin(low)
    assert np.nanmax(greatest) == np.nanmax(high)


def test_a_line_without_values_has_no_gap():
    assert [len(each) for each in with_gaps(np.zeros(0), np.zeros(0))] == [0, 0]
    assert [len(each) for each in thinned_band(np.zeros(1), np.ones(1), np.ones(1))] == [1, 1, 1]
