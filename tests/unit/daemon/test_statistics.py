"""Loop statistics against NumPy's percentiles."""

import numpy as np
import pytest

from palmd.daemon.statistics import LoopStatistics, summary


@pytest.mark.parametrize("count", [1, 2, 7, 99, 100])
def test_a_summary_agrees_with_numpy(count):
    values = np.random.default_rng(count).exponential(size=count)
    assert summary(values) == pytest.approx(np.percentile(values, (50, 99, 100), method="inverted_cdf"))
    assert summary(()) == (0.0, 0.0, 0.0)


def test_loop_statistics_are_in_milliseconds_and_count():
    statistics = LoopStatistics(100.0)
    statistics.tick(7.0, 7.0, 0)  # of the previous second
    for _ in range(99):
        statistics.tick(1e-4, 1e-3, 0)
    statistics.tick(5e-3, 22e-3, 2)
    fields = statistics.fields()
    assert fields["ticks"] == 101
    assert fields["overruns"] == 2
    assert fields["lateness_p50_ms"] == pytest.approx(0.1)
    assert fields["lateness_max_ms"] == pytest.approx(5.0)
    assert fields["lateness_ms"] == pytest.approx([0.1] * 99 + [5.0])
    assert fields["work_p99_ms"] == pytest.approx(1.0)
    assert fields["work_max_ms"] == pytest.approx(22.0)
