"""The fault campaign's table against the daemon's own, and how a reaction is measured and judged."""

import json
import math
from dataclasses import replace

import pytest

from palmd.faults import TABLE
from palmd.rig.fault_injection import PORTS
from tools.studies.fault_reaction import (
    STANDING_RAD_S,
    Reaction,
    ReactionWatch,
    StateReport,
    TrueMotion,
    all_as_promised,
    as_line,
    complete,
    differences,
    standstill,
    summary,
    table,
)
from tools.studies.fault_rows import HOST_ALIVE_S, NAMES, ROWS, FaultRow
from tools.studies.study_processes import InjectedFault

ROW = FaultRow(
    "mute",
    "it falls silent",
    InjectedFault("mute", "pad1"),
    "hold",
    ("pad1-mute",),
    (("pad1-silent", "hold"),),
    ("pad1-lifted",),
)
GOOD = Reaction({"pad1-silent": "hold", "pad1-garbled": "degrade"}, "hold", 0.05, 0.1, 0.02)


# ---------------------------------------------------------------------------------------------- the two tables


@pytest.mark.parametrize("row", ROWS, ids=NAMES)
def test_a_rows_promise_agrees_with_the_daemons_table(row):
    for code, severity in row.faults:
        assert TABLE[code].severity == severity
    assert set(row.may) <= TABLE.keys()
    gravest = (
        "fault" if ("stop") in dict(row.faults).values() else "hold" if "hold" in dict(row.faults).values() else ""
    )
    assert row.state == (gravest or "tracking") or row.name == "daemon-killed"


def test_every_port_has_a_row_for_every_injection():
    assert len(set(NAMES)) == len(NAMES)
    ways = ("dead", "garbled", "late", "mute", "replaced", "foreign")
    assert {f"{port}-{way}" for port in PORTS for way in ways} <= set(NAMES)


# -------------------------------------------------------------------------------------------------- measuring


def turning(*rates):
    """Reports of palm 1 at these rates (rad/s), one per 10 ms from 100 s; palm 2 stands."""
    return [TrueMotion(100.0 + 0.01 * i, (0.01 * sum(rates[:i]), 1.0), (rate, 0.0)) for i, rate in enumerate(rates)]


def test_the_arm_is_at_rest_from_the_last_time_it_stops():
    still, turned = standstill(turning(1.0, 0.5, 0.0, 0.4, 0.0, 0.001), 100.0)
    assert still == pytest.approx(0.04)
    assert turned == pytest.approx(0.019)
    assert all(map(math.isnan, standstill(turning(1.0, 0.0, 1.0), 100.0)))
    assert all(map(math.isnan, standstill(turning(1.0, STANDING_RAD_S), 100.0)))
    assert all(map(math.isnan, standstill([], 100.0)))


def test_a_palm_that_reverses_is_not_at_rest():
    assert standstill(turning(1.0, -0.5, 0.0), 100.0)[0] == pytest.approx(0.02)


def test_reports_before_the_injection_do_not_count():
    watch = ReactionWatch(
        states=[
            StateReport(99.9, "tracking", {"no-realtime": "note", "pad1-silent": "hold"}),
            StateReport(100.05, "hold", {"no-realtime": "note", "pad1-silent": "hold"}),
            StateReport(100.15, "tracking", {"arm-late": "degrade"}),
        ],
        motions=turning(1.0, 0.0),
    )
    reaction = watch.reaction(ROW, 100.0)
    assert reaction.faults == {"pad1-silent": "hold", "arm-late": "degrade"}
    assert reaction.state == "hold"
    assert reaction.noticed_s == pytest.approx(0.05)
    assert reaction.still_s == pytest.approx(0.01)


# ---------------------------------------------------------------------------------------------------- judging


def test_a_reaction_as_promised_has_no_differences():
    assert differences(ROW, GOOD) == []
    assert complete(ROW, GOOD)
    assert all_as_promised([(ROW, [GOOD, GOOD])])


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        ({"faults": {}}, "no pad1-silent"),
        ({"faults": {"pad1-silent": "note"}}, "pad1-silent is note, not hold"),
        ({"faults": {**GOOD.faults, "pad2-silent": "hold"}}, "unexpected pad2-silent"),
        ({"state": "tracking"}, "state tracking, not hold"),
        ({"state": "fault"}, "state fault, not hold"),
        ({"state": ""}, "state not reported, not hold"),
        ({"still_s": math.nan}, "the arm did not come to rest"),
        ({"wrong": ("3 recorded messages are lost",)}, "3 recorded messages are lost"),
    ],
)
def test_each_deviation_is_reported(change, difference):
    reaction = replace(GOOD, **change)
    assert differences(ROW, reaction) == [difference]
    assert not all_as_promised([(ROW, [GOOD, reaction])])


def test_an_optional_stop_fault_changes_the_expected_state():
    row = replace(ROW, state="tracking", faults=(("pad1-garbled", "degrade"),))
    reaction = Reaction({"pad1-garbled": "degrade", "pad1-lifted": "hold"}, "hold", 0.5, 0.6, 0.1)
    assert differences(row, reaction) == []
    assert differences(row, replace(reaction, state="fault")) == ["state fault, not tracking"]
    assert differences(row, Reaction({"pad1-garbled": "degrade"}, "hold", 0.5, 0.6)) == ["state hold, not tracking"]


def test_reactions_are_reported_as_table_and_lines():
    slow = replace(GOOD, still_s=0.2, wrong=("something",))
    text = table([(ROW, [GOOD, slow]), (ROWS[0], [])])
    assert text.splitlines()[0].split() == [
        "row",
        "expected",
        "observed",
        "noticed",
        "still",
        "worst",
        "goal",
        "why",
        "verdict",
    ]
    assert text.splitlines()[1].split()[-6:] == ["50", "150", "200", f"{HOST_ALIVE_S * 1e3:.0f}", "-", "something"]
    assert "median 150 ms, worst 200 ms; 0 of 2 within 60 ms" in summary([(ROW, [GOOD, slow])])
    line = json.loads(json.dumps(as_line(ROW, replace(GOOD, noticed_s=math.nan)), allow_nan=False))
    assert (line["noticed_ms"], line["still_ms"], line["goal_ms"], line["differs"]) == (None, 100.0, 60, [])
