"""`palmd doctor latency`: each tick is counted once, percentiles agree with NumPy, and timers are named."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest

from palmd.daemon.statistics import LoopStatistics
from palmd.doctor import load, wakeups
from palmd.doctor.lateness import Case, TickLateness, branches, lines, percentiles, table


def test_each_tick_is_counted_exactly_once():
    statistics, gathered = LoopStatistics(100.0), TickLateness()
    true = np.random.default_rng(0).exponential(1e-3, 1000)
    gathered.take(statistics.fields())
    for k, lateness in enumerate(true):
        statistics.tick(lateness, 1e-3, 2 if k % 100 == 50 else 0)
        if k % 97 == 96 or k == 999:  # messages come irregularly
            gathered.take(statistics.fields())
    assert gathered.values_ms == pytest.approx(list(true * 1e3))
    assert gathered.skipped == 20


def test_ticks_before_the_first_message_do_not_count():
    statistics, gathered = LoopStatistics(100.0), TickLateness()
    for _ in range(150):
        statistics.tick(0.5, 1e-3, 1)
    gathered.take(statistics.fields())
    statistics.tick(1e-3, 1e-3, 0)
    gathered.take(statistics.fields())
    assert gathered.values_ms == pytest.approx([1.0])
    assert gathered.skipped == 0


@pytest.mark.parametrize("count", [1, 10, 999, 1001])  # at 1000 NumPy rounds 99.9 % up
def test_percentiles_agree_with_numpy(count):
    values = np.random.default_rng(count).exponential(size=count)
    expected = [np.percentile(values, p, method="inverted_cdf") for p in (50, 99, 99.9, 100)]
    assert percentiles(list(values)) == pytest.approx(tuple(expected))
    assert all(map(math.isnan, percentiles([])))


def test_the_table_has_ratios_of_99th_percentiles_and_marks_missing_values():
    ticks = [0.1] * 98 + [0.3] * 2
    rows = table([Case("idle", ticks, 1, [0.2] * 100), Case("busy", ticks, 0, ())], "cyclictest").splitlines()
    assert rows[1].split() == ["idle", "100", "1", "0.100", *["0.300"] * 3, *["0.200"] * 4, "1.50"]
    assert rows[2].split()[-5:] == ["-"] * 5
    assert "cyclictest: p50" in rows[0]


def test_a_histogram_of_cyclictest_is_parsed():
    assert wakeups.spread({"12": 2, "9": 1}) == pytest.approx((0.009, 0.012, 0.012))


def test_without_cyclictest_the_python_timer_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(wakeups.shutil, "which", lambda _: None)
    meter = wakeups.Meter(0.2, 0.01, tmp_path)
    found = meter.result()
    meter.close()
    assert found.by.startswith("a timer in Python")
    assert len(found.lateness_ms) == 20
    assert all(lateness >= 0.0 for lateness in found.lateness_ms)


def test_a_timer_that_fails_gives_no_result(tmp_path, monkeypatch):
    monkeypatch.setattr(wakeups.shutil, "which", lambda _: None)
    meter = wakeups.Meter(0.1, 0.01, tmp_path / "missing")
    assert meter.result() is None
    meter.close()


@pytest.mark.parametrize("work", ["processor({starter})", "disk({starter}, {folder!r})", "network({starter})"])
@pytest.mark.parametrize("alive_s", [0.0, 0.6])  # the starter ends before the load begins, or while it runs
def test_a_load_runs_until_its_starter_has_ended(work, alive_s, tmp_path):
    call = work.format(starter="int(sys.argv[1])", folder=str(tmp_path))
    starter = (
        "import os, subprocess, sys, time\n"
        f"program = {f'import sys; from {load.__name__} import *; {call}'!r}\n"
        "command = [sys.executable, '-c', program, str(os.getpid())]\n"
        "load = subprocess.Popen(command)\n"
        f"time.sleep({alive_s})\n"
        "print(load.pid, load.poll())\n"
    )
    said = subprocess.run([sys.executable, "-c", starter], capture_output=True, text=True, check=True)
    assert said.stderr == ""
    pid, status = said.stdout.split()
    assert status == "None"
    gone = "import os, sys, time\nwhile os.path.exists(f'/proc/{sys.argv[1]}'): time.sleep(0.02)"
    subprocess.run([sys.executable, "-c", gone, pid], timeout=30, check=True)


def test_the_timer_reports_whether_it_had_real_time_priority(tmp_path):
    report = tmp_path / "report.json"
    subprocess.run([sys.executable, "-m", wakeups.__name__, "3", "0.001", str(report)], check=True)
    timed = json.loads(report.read_text())
    assert isinstance(timed["fifo"], bool)
    assert len(timed["lateness_ms"]) == 3


# Recommended changes

GOOD, LATE = [0.1] * 100, [5.0] * 100


def changes(*cases):
    return [each.change for each in branches(cases) if each.change]


def test_a_punctual_machine_needs_no_change():
    cases = [Case(name, GOOD, 0, GOOD) for name in ("idle", "every core busy", "disk busy")]
    assert changes(*cases) == []
    assert lines(tuple(branches(cases)))[-1].endswith("nothing to change")


def test_an_idle_machine_that_wakes_late_is_the_only_finding():
    (change,) = changes(Case("idle", LATE, 3, LATE), Case("disk busy", LATE, 3, LATE))
    assert "PREEMPT_RT" in change


def test_late_ticks_on_a_machine_that_wakes_in_time_need_priority():
    (change,) = changes(Case("idle", LATE, 3, GOOD), Case("disk busy", LATE, 3, GOOD))
    assert "priority" in change


@pytest.mark.parametrize(
    ("busy", "words"),
    [("every core busy", "isolcpus"), ("disk busy", "another disk"), ("network busy", "interrupts"),
     ("recorder and page", "another machine")],
)  # fmt: skip
def test_each_kind_of_load_has_its_recommendation(busy, words):
    (change,) = changes(Case("idle", GOOD, 0, GOOD), Case(busy, LATE, 9, GOOD))
    assert words in change
