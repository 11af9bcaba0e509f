"""Each check of a soak passes sound data and finds its one defect."""

import math

import numpy as np
import pytest

from palmd.record.recheck import CheckedTick, Difference
from palmd.record.run import Survey
from palmd.rig.fault_injection import ARM, INJECTABLE_FAULTS, PADS
from tools.studies.harness import as_line
from tools.studies.soak_fault_injection import QUIET_S, Visitor, draw
from tools.studies.soak_findings import (
    Numbers,
    ProcessSeries,
    Second,
    SoakWatch,
    all_met,
    at_most,
    between,
    leaks,
    minutes,
    punctuality,
    recorded,
    replayed,
    slope,
    table,
    without_goal,
)  # fmt: skip
from tools.studies.study_processes import InjectedFault

HOUR_S = 3600.0


def missed(findings):
    return {finding.name for finding in findings if finding.met is False}


# ------------------------------------------------------------------------------------------------------ findings


def test_only_judged_goals_can_be_missed():
    met, none = between("g", "x", 0, 0, 0), without_goal("g", "y", 3.0)
    assert all_met([met, none])
    assert not all_met([])
    for bad in (between("g", "x", 1, 0, 0), at_most("g", "x", 2.1, 2.0), at_most("g", "x", math.nan, 2.0)):
        assert not all_met([met, bad])
        assert "MISSED" in table([met, bad])
    assert as_line(at_most("g", "x", math.nan, 2.0))["value"] is None


# ---------------------------------------------------------------------------------------------------------- leaks


def process(mb_per_hour=0.0, descriptors_at_end=12, warm_up_mb=30.0, seconds=HOUR_S):
    t = np.arange(0.0, seconds, 5.0)
    noise = np.random.default_rng(1).normal(0.0, 0.3, t.size)
    rss = 100.0 + warm_up_mb * np.minimum(t / 600.0, 1.0) + mb_per_hour * t / HOUR_S + noise
    descriptors = np.where(t > 2.0 / 3.0 * seconds, descriptors_at_end, 12)
    return ProcessSeries((t + 50.0).tolist(), rss.tolist(), descriptors.tolist(), [3] * t.size)


def test_a_slow_leak_is_found_in_noise():
    findings = leaks({"daemon": process(mb_per_hour=2.0), "page": process()}, 50.0, HOUR_S)
    assert missed(findings) == {"daemon memory"}
    assert findings[0].value == pytest.approx(2.0, abs=0.3)


def test_increasing_descriptors_and_threads_are_found():
    leaking = process(descriptors_at_end=13)
    leaking.threads[-300:] = [4] * 300
    assert missed(leaks({"daemon": leaking}, 50.0, HOUR_S)) == {"daemon descriptors", "daemon threads"}


def test_warm_up_memory_and_temporary_descriptors_are_no_leak():
    busy = process()
    busy.descriptors[::3] = [20] * len(busy.descriptors[::3])
    assert missed(leaks({"daemon": process(), "page": busy}, 50.0, HOUR_S)) == set()


def test_the_slope_of_a_short_soak_is_not_judged():
    findings = leaks({"daemon": process(mb_per_hour=100.0, seconds=600.0)}, 50.0, 600.0)
    assert findings[0].met is None
    assert findings[0].value > 50.0


def test_the_slope_is_robust_against_outliers():
    t = np.arange(1000.0)
    values = 3.0 + 0.5 * t
    values[::10] += 1e6
    assert slope(t.tolist(), values.tolist()) == pytest.approx(0.5)
    assert math.isnan(slope([1.0], [1.0]))


# ------------------------------------------------------------------------------------------------------- lateness


def seconds_of(count=HOUR_S, missed_in=None, drift_ms_h=0.0):
    rng = np.random.default_rng(2)
    overruns, found = 0, []
    for i in range(int(count)):
        overruns += (missed_in or {}).get(i, 0)
        late = 0.05 + drift_ms_h * i / HOUR_S + 0.01 * rng.random(100)
        found.append(Second(100.0 + i, 100 * (i + 1), overruns, tuple(late)))
    return found


def test_a_punctual_hour_meets_every_goal():
    findings = punctuality(seconds_of())
    assert missed(findings) == set()
    assert next(one for one in findings if one.name == "p50").value == pytest.approx(0.055, abs=1e-3)
    assert len(minutes(seconds_of())) == 59


def test_too_many_missed_ticks_are_found_and_35_per_hour_are_allowed():
    allowed = dict.fromkeys(range(105, 3600, 100), 1)
    assert missed(punctuality(seconds_of(missed_in=allowed))) == set()
    assert missed(punctuality(seconds_of(missed_in=allowed | {7: 2}))) == {"missed ticks"}


def test_a_run_of_misses_is_found_even_if_the_total_is_small():
    assert missed(punctuality(seconds_of(missed_in={5: 1, 6: 1, 7: 1}))) == {"longest run of seconds with misses"}
    assert missed(punctuality(seconds_of(missed_in={400: 31}))) == {"worst minute's misses"}


def test_a_drift_is_found():
    assert missed(punctuality(seconds_of(drift_ms_h=0.3))) == {"drift of the median"}


def test_without_real_time_priority_lateness_is_not_judged():
    assert all(one.met is None for one in punctuality(seconds_of(missed_in={5: 99, 6: 9, 7: 9}), goal=False))


def test_a_silent_daemon_misses_the_goal():
    assert missed(punctuality([])) == {"missed ticks"}


# ------------------------------------------------------------------------------------------------------ recording


def survey(first=0, count=100, missing=0):
    return {"palm/state": Survey(count, first, missing, 0, 1)}


def test_a_recording_without_gaps_in_two_files_meets_every_goal():
    heard = {"palm/state": Numbers(3, 149)}
    assert missed(recorded([survey(), survey(100, 50)], heard, 150)) == set()


@pytest.mark.parametrize(
    ("surveys", "last", "published"),
    [
        ([survey(count=99, missing=1)], 99, 99),
        ([survey(first=2)], 101, 100),
        ([survey(), survey(101, 50)], 150, 150),
        ([survey()], 100, 100),
        ([], 3, 0),
    ],
)
def test_gaps_are_found_anywhere(surveys, last, published):
    assert "topics with gaps" in missed(recorded(surveys, {"palm/state": Numbers(0, last)}, published))


def test_published_but_unrecorded_messages_are_found():
    heard = {"palm/state": Numbers(0, 99)}
    assert missed(recorded([survey()], heard, 101)) == {"messages published and not recorded"}


def test_a_replay_that_differs_or_is_empty_is_found():
    same = CheckedTick(0, ())
    assert missed(replayed([same, same])) == set()
    other = CheckedTick(1, (Difference(1, "psi_rad", 1.0, 2.0, 1.0),))
    assert missed(replayed([same, other])) == {"ticks replayed that differ"}
    assert missed(replayed([])) == {"ticks replayed"}


# -------------------------------------------------------------------------------------------------------- others


def test_draws_repeat_by_seed_and_differ_between_seeds():
    first, again, other = (draw(np.random.default_rng(seed), HOUR_S) for seed in (1, 1, 2))
    assert first == again != other
    assert all(doing.t_s + doing.act.for_s <= HOUR_S - QUIET_S for doing in first)
    assert [doing.t_s for doing in first] == sorted(doing.t_s for doing in first)


def test_an_hour_has_every_injection_on_every_port_and_every_client():
    acts = [doing.act for doing in draw(np.random.default_rng(1), 10 * HOUR_S)]
    drawn = {(act.name, act.port) for act in acts if isinstance(act, InjectedFault)}
    assert drawn == {(name, port) for name, trick in INJECTABLE_FAULTS.items() for port in trick.ports or (None,)}
    assert {act.who for act in acts if isinstance(act, Visitor)} == {"listener", "deaf", "page", "asker"}
    assert {port for _, port in drawn} == {*PADS, *ARM, None}


class Heard:
    def __init__(self, topic, t, seq, **fields):
        self.topic, self.fields = topic, {"mono_ns": round(t * 1e9), "seq": seq} | fields


def test_the_watch_counts_gaps_and_keeps_the_last_state_and_samples():
    watch = SoakWatch()
    for t, seq, state in ((1.0, 0, "ready"), (1.1, 1, "ready"), (1.2, 3, "tracking")):
        watch.take(Heard("palm/state", t, seq, state=state, faults=[], severities=[]))
    assert watch.numbers["palm/state"].missing == 1
    assert watch.state == "tracking"
    watch.take(Heard("palm/loop", 5.0, 0, ticks=500, overruns=2, lateness_ms=[0.1]))
    assert watch.seconds == [Second(5.0, 500, 2, (0.1,))]
    assert watch.t_loop == 5.0
    watch.sample("daemon", 1.0, 70.0, 9, 3)
    assert watch.processes["daemon"] == ProcessSeries([1.0], [70.0], [9], [3])
