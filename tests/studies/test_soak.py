"""A soak's judges: each passes what is sound, and sees the one thing that it is there for."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palmd.record.recheck import Checked, Difference
from palmd.record.run import Survey
from palmd.rig.fault_injection import ARM, INJECTABLE_FAULTS, PADS
from tools.studies import soak_behaviour as behaviour
from tools.studies import soak_counters as counters
from tools.studies.fault_reaction import ToldState
from tools.studies.soak import all_met, as_line, at_most, between, table, told
from tools.studies.soak_behaviour import Counted, GivenCommand, PossibleCause
from tools.studies.soak_fault_injection import QUIET_S, SoakFault, Visit, draw
from tools.studies.soak_lateness import Second, minutes, punctuality
from tools.studies.soak_recording import recorded, replayed
from tools.studies.soak_slopes import ProcessSeries, leaks, slope
from tools.studies.soak_watch import Numbers, Process, SoakWatch

HOUR_S = 3600.0


def missed(findings):
    return {finding.name for finding in findings if finding.met is False}


# ------------------------------------------------------------------------------------------------------ findings


def test_a_missed_goal_is_missed_and_an_unjudged_one_is_not():
    met, none = between("g", "x", 0, 0, 0), told("g", "y", 3.0)
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


def test_memory_of_the_warm_up_is_no_leak():
    assert missed(leaks({"daemon": process()}, 50.0, HOUR_S)) == set()


def test_a_slow_leak_is_seen_through_the_noise():
    findings = leaks({"daemon": process(mb_per_hour=2.0), "page": process()}, 50.0, HOUR_S)
    assert missed(findings) == {"daemon memory"}
    assert findings[0].value == pytest.approx(2.0, abs=0.3)


def test_descriptors_and_threads_that_become_more_are_seen():
    leaking = process(descriptors_at_end=13)
    leaking.threads[-300:] = [4] * 300
    assert missed(leaks({"daemon": leaking}, 50.0, HOUR_S)) == {"daemon descriptors", "daemon threads"}


def test_descriptors_that_come_and_go_are_no_leak():
    busy = process()
    busy.descriptors[::3] = [20] * len(busy.descriptors[::3])
    assert missed(leaks({"page": busy}, 50.0, HOUR_S)) == set()


def test_a_short_soak_judges_no_slope():
    findings = leaks({"daemon": process(mb_per_hour=100.0, seconds=600.0)}, 50.0, 600.0)
    assert findings[0].met is None
    assert findings[0].value > 50.0


def test_the_slope_is_that_of_the_line_whatever_lies_off_it():
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


def test_too_many_missed_ticks_are_seen_and_35_of_an_hour_are_not():
    allowed = dict.fromkeys(range(105, 3600, 100), 1)
    assert missed(punctuality(seconds_of(missed_in=allowed))) == set()
    assert missed(punctuality(seconds_of(missed_in=allowed | {7: 2}))) == {"missed ticks"}


def test_a_storm_is_seen_even_where_the_total_is_small():
    assert missed(punctuality(seconds_of(missed_in={5: 1, 6: 1, 7: 1}))) == {"longest run of seconds with misses"}
    assert missed(punctuality(seconds_of(missed_in={400: 31}))) == {"worst minute's misses"}


def test_what_is_missed_while_others_have_the_processors_is_told_apart():
    waits = [
        replace(one, waited_ms=50.0 if i >= 300 else 0.0)
        for i, one in enumerate(seconds_of(missed_in={300: 4, 900: 3}))
    ]
    told_apart = {one.name: one.value for one in punctuality(waits)}
    assert told_apart["missed ticks, while others had the processors"] == 4
    assert told_apart["missed ticks, number"] == 7


def test_a_drift_is_seen():
    assert missed(punctuality(seconds_of(drift_ms_h=0.3))) == {"drift of the median"}


def test_without_real_time_priority_nothing_is_judged():
    assert all(one.met is None for one in punctuality(seconds_of(missed_in={5: 99, 6: 9, 7: 9}), goal=False))


def test_a_daemon_that_was_not_heard_has_missed_its_goal():
    assert missed(punctuality([])) == {"missed ticks"}


# ------------------------------------------------------------------------------------------------------- counters


def both_ends(**changes):
    """What rig and daemon count of 1000 packets, 10 of them altered, 20 withheld, and of as many lines."""
    rig, daemon = {}, {}
    for name in ("pad1", "arm"):
        rig |= {
            f"{name}_messages": 1000,
            f"{name}_altered": 10,
            f"{name}_withheld": 20,
            f"{name}_bytes_on_line": 5880,
            f"{name}_bytes_sent": 5880,
            f"{name}_bytes_lost": 0,
            f"{name}_bytes_waiting": 0,
        }
        daemon |= {f"{name}_port_opens": 1, f"{name}_port_losses": 0, f"{name}_port_bytes_read": 5880}
        daemon |= {f"{name}_bytes": 5880}
    spoilt = {"packets": 974, "bad_header": 20, "bad_data": 12, "truncated": 4, "gaps": 0}
    lines = {"lines": 974, "crc_errors": 6, "unframed": 0, "overlong": 0}
    rig |= {f"pad1_sent_{what}": n for what, n in spoilt.items()} | {f"arm_sent_{what}": n for what, n in lines.items()}
    daemon |= {f"pad1_{what}": n for what, n in spoilt.items()} | {f"arm_{what}": n for what, n in lines.items()}
    daemon |= {"pad1_bytes_discarded": 36, "arm_setpoints": 500, "arm_port_bytes_written": 14000}
    daemon |= {"arm_port_bytes_dropped": 0}
    rig |= {"host_setpoints": 500, "host_setpoints_touched": 4, "setpoints": 497, "duplicates": 0}
    rig |= {"arm_bytes_heard": 14000, "setpoints_outside_limits": 0}
    for key, change in changes.items():
        side, _, name = key.partition("__")
        (rig if side == "rig" else daemon)[name] += change
    return rig, daemon


def judged(**changes):
    rig, daemon = both_ends(**changes)
    return missed([*counters.pad("pad1", rig, daemon, 9600), *counters.arm(rig, daemon, 38400)])


def test_ends_that_agree_are_in_order():
    assert judged() == set()


@pytest.mark.parametrize(
    ("changes", "seen"),
    [
        # a packet lost in the daemon, its bytes read
        ({"daemon__pad1_packets": -1}, {"pad1 bytes of no packet", "pad1 whole packets sent and not decoded"}),
        # a packet lost on the way to the daemon, which counts for one that it has not seen
        (
            {"daemon__pad1_packets": -1, "daemon__pad1_bytes": -6, "daemon__pad1_port_bytes_read": -6},
            {"pad1 whole packets sent and not decoded"},
        ),
        ({"daemon__pad1_packets": 1, "daemon__pad1_bytes": 6}, None),  # a packet from nowhere
        ({"daemon__pad1_bytes": -1}, None),
        ({"daemon__pad1_port_bytes_read": 1, "daemon__pad1_bytes": 1}, None),
        ({"daemon__pad1_port_bytes_read": -49, "daemon__pad1_bytes": -49}, None),
        ({"rig__pad1_bytes_on_line": 1}, {"pad1 bytes astray in the rig"}),
        ({"rig__pad1_messages": 10}, {"pad1 intact packets lost"}),
        (
            {"daemon__pad1_bad_header": 1, "daemon__pad1_truncated": -1},
            {"pad1 bad_header beyond the rig's", "pad1 truncated beyond the rig's"},
        ),
        ({"daemon__arm_lines": -1}, {"arm whole lines sent and not read"}),
        ({"daemon__arm_crc_errors": 1}, {"arm crc_errors beyond the rig's"}),
        ({"daemon__arm_setpoints": 1}, {"set-points sent and not heard"}),
        ({"daemon__arm_setpoints": -1}, {"set-points sent and not heard"}),
        ({"rig__setpoints": -6}, {"set-points heard and not received"}),
        ({"rig__setpoints": 4}, {"set-points heard and not received"}),
        ({"rig__arm_bytes_heard": 65}, {"arm bytes written and not heard"}),
        ({"rig__setpoints_outside_limits": 1}, {"set-points outside the limits"}),
    ],
)
def test_whatever_is_lost_between_the_ends_is_seen(changes, seen):
    found = judged(**changes)
    assert found
    assert seen is None or found == seen


@pytest.mark.parametrize(("packets", "seen"), [(5, set()), (6, {"pad1 packets cut by a gap"})])
def test_packets_in_which_the_kernel_paused_have_that_for_a_reason(packets, seen):
    cut = {"packets": -1, "bad_header": 4, "truncated": 2, "bytes_discarded": 6}
    changes = {f"daemon__pad1_{what}": packets * change for what, change in cut.items()}
    assert "pad1 whole packets sent and not decoded" in judged(**changes)
    assert judged(**changes, daemon__pad1_gaps=packets) == seen


def test_what_was_under_way_when_a_port_was_lost_may_be_lost_and_no_more():
    reopened = {"daemon__pad1_port_opens": 1, "daemon__pad1_port_losses": 1}
    lost = {"daemon__pad1_port_bytes_read": -18, "daemon__pad1_bytes": -18, "daemon__pad1_packets": -3}
    assert judged(**reopened, **lost) == set()
    assert judged(**lost)
    far = {name: 20 * change for name, change in lost.items()}
    assert judged(**reopened, **far)


# ------------------------------------------------------------------------------------------------------ behaviour

TRACKING, HELD = ToldState(0.0, "tracking", {}), ToldState(10.0, "hold", {"pad1-silent": "hold"})


def test_a_fault_needs_a_cause_of_its_port_at_its_time():
    mute = PossibleCause("mute", "pad1", 9.0, 11.0)
    assert behaviour.unexplained([TRACKING, HELD], [mute]) == []
    assert behaviour.unexplained([TRACKING, HELD], []) == ["pad1-silent after 10.0 s"]
    for wrong in (
        PossibleCause("mute", "pad2", 9.0, 11.0),
        PossibleCause("mute", "pad1", 10.5, 11.0),
        PossibleCause("mute", "pad1", 1.0, 2.0),
        PossibleCause("break", "arm", 9.9, 10.0),
    ):
        assert behaviour.unexplained([TRACKING, HELD], [wrong])


def test_what_the_machine_held_up_explains_the_pad_and_is_told_apart():
    kept_back = PossibleCause("batch", "pad1", 9.8, 10.2)
    assert behaviour.unexplained([TRACKING, HELD], [kept_back]) == []
    assert behaviour.unexplained([TRACKING, HELD], [PossibleCause("batch", "pad2", 9.8, 10.2)])
    findings = behaviour.behaviour([TRACKING, HELD], [kept_back], [], [], [], "hold")
    assert {one.name: one.value for one in findings}["faults by the machine alone"] == 1
    assert missed(findings) == set()


def test_notes_need_no_cause_and_a_standing_fault_comes_once():
    note = ToldState(1.0, "tracking", {"loop-overrun": "note"})
    assert behaviour.unexplained([TRACKING, note], []) == []
    assert behaviour.unexplained([HELD, ToldState(90.0, "fault", {"pad1-silent": "hold"})], []) == []


def test_every_trick_explains_something():
    for name, trick in INJECTABLE_FAULTS.items():
        for port in trick.ports or (None,):
            assert PossibleCause(name, port, 0.0, 1.0)._codes(), name


def test_tracking_without_a_command_is_seen():
    ready, again = ToldState(5.0, "ready", {}), ToldState(10.0, "tracking", {})
    assert behaviour.uncalled([TRACKING, ready, again], [GivenCommand(9.5, "arm")]) == []
    assert behaviour.uncalled([TRACKING, ready, again], [GivenCommand(10.01, "arm")]) == []
    assert behaviour.uncalled([TRACKING, ready, again], [GivenCommand(9.5, "start"), GivenCommand(1.0, "arm")])
    assert behaviour.uncalled([TRACKING, HELD, ToldState(12.0, "tracking", {})], [GivenCommand(11.9, "start")]) == []
    assert behaviour.uncalled([TRACKING, HELD, ToldState(12.0, "tracking", {})], [])


def test_an_arm_that_is_left_standing_is_seen():
    states = [
        TRACKING,
        HELD,
        ToldState(12.0, "ready", {}),
        ToldState(70.0, "tracking", {}),
        ToldState(80.0, "ready", {}),
    ]
    assert behaviour.longest_rest(states, 90.0) == pytest.approx(60.0)
    assert behaviour.longest_rest(states, 200.0) == pytest.approx(120.0)
    assert behaviour.longest_rest([TRACKING], 500.0) == 0.0
    left = behaviour.behaviour(states, [], [], [Counted(200.0, 0)], [], "ready")
    assert "longest time without tracking" in missed(left)


def test_set_points_in_a_state_that_allows_none_are_seen():
    states = [TRACKING, ToldState(10.0, "fault", {}), ToldState(20.0, "tracking", {})]
    counted = [Counted(9.0, 100), Counted(10.4, 140), Counted(11.0, 140), Counted(19.0, 140), Counted(21.0, 200)]
    assert behaviour.commanded_while_not(states, counted) == 0
    counted[3:] = [Counted(19.0, 141), Counted(21.0, 200)]
    assert behaviour.commanded_while_not(states, counted) == 1


def test_the_end_must_be_ready_or_hold():
    assert missed(behaviour.behaviour([TRACKING], [], [], [], [], "ready")) == set()
    assert missed(behaviour.behaviour([TRACKING], [], [], [], [], "fault")) == {"ended ready or held"}


# ------------------------------------------------------------------------------------------------------ recording


def survey(first=0, count=100, missing=0):
    return {"palm/state": Survey(count, first, missing, 0, 1)}


def test_a_recording_without_gaps_over_two_files():
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
def test_gaps_are_seen_wherever_they_are(surveys, last, published):
    assert "topics with gaps" in missed(recorded(surveys, {"palm/state": Numbers(0, last)}, published))


def test_messages_that_were_published_and_not_recorded_are_seen():
    heard = {"palm/state": Numbers(0, 99)}
    assert missed(recorded([survey()], heard, 101)) == {"messages published and not recorded"}


def test_a_replay_that_differs_or_is_empty_is_seen():
    same = Checked(0, ())
    assert missed(replayed([same, same])) == set()
    other = Checked(1, (Difference(1, "psi_rad", 1.0, 2.0, 1.0),))
    assert missed(replayed([same, other])) == {"ticks replayed that differ"}
    assert missed(replayed([])) == {"ticks replayed"}


# -------------------------------------------------------------------------------------------------------- the rest


def test_the_same_seed_draws_the_same_and_another_one_another():
    first, again, other = (draw(np.random.default_rng(seed), HOUR_S) for seed in (1, 1, 2))
    assert first == again != other
    assert all(doing.t_s + doing.act.for_s <= HOUR_S - QUIET_S for doing in first)
    assert [doing.t_s for doing in first] == sorted(doing.t_s for doing in first)


def test_an_hour_has_every_trick_on_every_port_and_every_visitor():
    acts = [doing.act for doing in draw(np.random.default_rng(1), 10 * HOUR_S)]
    drawn = {(act.name, act.port) for act in acts if isinstance(act, SoakFault)}
    assert drawn == {(name, port) for name, trick in INJECTABLE_FAULTS.items() for port in trick.ports or (None,)}
    assert {act.who for act in acts if isinstance(act, Visit)} == {"listener", "deaf", "page", "asker"}
    assert {port for _, port in drawn} == {*PADS, *ARM, None}


class Heard:
    def __init__(self, topic, t, seq, **fields):
        self.topic, self.fields = topic, {"mono_ns": round(t * 1e9), "seq": seq} | fields


def truth(t, seq, **changes):
    fields = {f"{name}{i}{unit}": value for i in (1, 2) for name, unit, value in TOUCHING} | changes
    return Heard("rig/truth", t, seq, **fields)


TOUCHING = (("s", "_m", 0.03), ("f", "_n", 1.0), ("contact", "", True))


def test_the_watch_sees_gaps_and_when_the_object_left_a_pad():
    watch = SoakWatch({"pad1": 0.055, "pad2": 0.055})
    watch.take(truth(1.0, 0))
    watch.take(truth(1.01, 1, contact2=False))
    watch.take(truth(1.02, 3, s2_m=0.06))
    watch.take(truth(1.03, 4))
    watch.take(truth(1.04, 5, f1_n=0.01))
    assert watch.numbers["rig/truth"].missing == 1
    assert watch.so_far() == [
        PossibleCause("parted", "pad2", 1.01, 1.03),
        PossibleCause("parted", "pad1", 1.04, math.inf),
    ]


def test_the_watch_sees_when_bytes_were_kept_back():
    watch = SoakWatch({"pad1": 0.055, "pad2": 0.055})
    plain = {"ticks": 1, "overruns": 0, "lateness_ms": [0.1], "arm_setpoints": 1, "pad2_batches": 4}
    for seq, batches in enumerate((7, 7, 8, 8)):
        watch.take(Heard("palm/loop", 5.0 + seq, seq, pad1_batches=batches, **plain))
    assert watch.causes == [PossibleCause("batch", "pad1", 6.0, 7.0)]


def test_the_watch_keeps_changes_of_state_and_samples():
    watch = SoakWatch({})
    for t in (1.0, 1.1, 1.2):
        watch.take(Heard("palm/state", t, round(10 * t) - 10, state="ready", faults=[], severities=[]))
    assert len(watch.states) == 1
    watch.sample("daemon", 1.0, Process(70.0, 9, 3))
    assert watch.processes["daemon"] == ProcessSeries([1.0], [70.0], [9], [3])
    status = {"clock_s": 0.9, "accepted": 3, "on_palms": True, "stalls": 0}
    watch.rig(status, 1.0)
    watch.rig(status | {"stalls": 2}, 2.0)
    assert watch.causes == [PossibleCause("stall", None, 1.0, 2.0)]
    assert watch.accepted[0] == Counted(0.9, 3)
