"""Loop statistics against numpy's percentiles."""

import numpy as np
import pytest

from palmd.daemon.statistics import LoopStatistics, Window


@pytest.mark.parametrize("count", [1, 2, 7, 99, 100, 101, 250])
def test_window_agrees_with_numpy(count):
    values = np.random.default_rng(count).exponential(size=count)
    window = Window(100)
    for value in values:
        window.add(value)
    last = values[-100:]
    expected = [np.percentile(last, p, method="inverted_cdf") for p in (50, 99, 100)]
    assert window.summary() == pytest.approx(tuple(expected))
    assert window.values() == list(last)


def test_empty_window_has_zeros():
    assert Window(5).summary() == (0.0, 0.0, 0.0)


def test_window_needs_room():
    with pytest.raises(ValueError, match="must be positive"):
        Window(0)


def test_loop_statistics_speak_milliseconds_and_count():
    statistics = LoopStatistics(100.0)
    for _ in range(99):
        statistics.tick(1e-4, 1e-3, 0)
    statistics.tick(5e-3, 22e-3, 2)
    fields = statistics.fields()
    assert fields["ticks"] == 100
    assert fields["overruns"] == 2
    assert fields["lateness_p50_ms"] == pytest.approx(0.1)
    assert fields["lateness_max_ms"] == pytest.approx(5.0)
    assert fields["lateness_ms"] == pytest.approx([0.1] * 99 + [5.0])
    assert fields["work_p99_ms"] == pytest.approx(1.0)
    assert fields["work_max_ms"] == pytest.approx(22.0)
