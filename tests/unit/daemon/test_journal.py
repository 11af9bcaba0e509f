"""`palm/log`: each event is reported once, with its cause, and the length is bounded."""

import math

import numpy as np
import pytest

from palmd.daemon.journal import FaultNotes, Journal, MotionNotes, ObjectNotes, RigNotes
from palmd.faults import TABLE
from palmd.messages import entries_of, log_fields
from palmd.quantities import LOG_ENTRIES
from palmd.system.rig_constants import RIG_NAMES

SILENT, LATE = TABLE["pad1-silent"], TABLE["arm-late"]


@pytest.fixture
def journal():
    return Journal()


def lines(journal):
    return [entry.line for entry in journal.entries]


def test_the_last_hundred_entries_are_kept_and_numbered_consecutively(journal):
    for i in range(250):
        journal.t = float(i)
        journal.add("plan", "over", f"the plan {i}")
    assert len(journal.entries) == LOG_ENTRIES
    assert [entry.number for entry in journal.entries] == list(range(150, 250))
    assert journal.count == 250


def test_repeated_entries_are_logged_once_a_second(journal):
    for i in range(1000):
        journal.t = 0.01 * i
        journal.add("command", "start", "start refused: no", who="ann")
    assert 9 <= journal.count <= 11


def test_a_text_has_a_bounded_length(journal):
    journal.add("command", "plan", "x" * 100_000)
    assert len(journal.entries[0].text) == 400


def test_a_fault_of_one_tick_is_logged_with_its_cause_and_duration(journal):
    notes = FaultNotes(journal)
    for t, active in ((1.0, ()), (1.01, (SILENT,)), (1.02, ())):
        journal.t = t
        notes.look(active, t, lambda code, at: (f"{code} at {at:g}", "mute"))
    came, went = journal.entries
    assert came.text == "pad 1 fell silent while the palms moved: pad1-silent at 1.01"
    assert (came.name, came.severity, came.t_s, came.code) == ("pad1-silent", "hold", 1.01, "mute")
    assert math.isnan(came.lasted_s)
    assert (went.name, went.lasted_s) == ("pad1-silent", pytest.approx(0.01))


@pytest.mark.parametrize(("fault", "most"), [(LATE, 22), (SILENT, 400)])
def test_a_flapping_mild_fault_does_not_displace_other_entries_and_a_grave_one_is_always_logged(journal, fault, most):
    notes = FaultNotes(journal)
    for i in range(400):
        journal.t = 0.025 * i
        notes.look((fault,) * (i % 2), journal.t, lambda *_: ("", ""))
    assert most // 2 < journal.count <= most


def test_an_objects_start_loss_and_recovery_are_logged(journal):
    notes = ObjectNotes(journal)

    def live(seconds, number, valid, untouched=()):
        for _ in range(round(seconds / 0.01)):
            journal.t += 0.01
            notes.look(number, valid, untouched, journal.t, lambda: "NIS 3.1 (limit 2)")

    live(0.5, 0, False)
    live(1.0, 1, False)
    live(1.0, 1, True)
    live(0.3, 1, False)  # too short to be logged
    live(1.0, 1, True)
    live(2.0, 1, False, (2,))
    live(1.0, 1, True)
    live(2.0, 1, False)
    live(0.1, 2, False)
    assert [(entry.name, entry.text.split(":")[0]) for entry in journal.entries] == [
        ("begun", "object 1 is new"),
        ("known", "object 1 is known"),
        ("lost", "object 1 is lost"),
        ("known", "object 1 is known again, after 2.0 s"),
        ("lost", "object 1 is lost"),
        ("begun", "object 2 is new"),
    ]
    assert "no contact on pad 2" in journal.entries[2].text
    assert "NIS 3.1 (limit 2)" in journal.entries[4].text


def test_a_contradicted_constant_is_logged_once_with_its_name(journal):
    notes, against = RigNotes(journal), np.zeros(len(RIG_NAMES))
    notes.look(against, lambda: ["?"])
    against[2] = -5.2
    for _ in range(3):
        notes.look(against.copy(), lambda: ["pad 1's scale seems off"])
    notes.look(np.zeros(len(RIG_NAMES)), list)
    first, second = journal.entries
    assert (first.kind, first.name) == ("rig", RIG_NAMES[2])
    assert "by 5.2σ: pad 1's scale seems off" in first.text
    assert "no longer" in second.text


def test_an_exploration_is_logged_with_its_goal_and_its_end(journal):
    class Goal:
        coverage, time_limit_s = 0.95, 60.0

    class Exploration:
        goal, coverage = Goal, math.nan

    notes, exploration = MotionNotes(journal), Exploration()
    notes.look(None, "", "", False, 0.0)
    notes.look(exploration, "it has just begun", "explore", False, 1.0)
    exploration.coverage = 0.97
    notes.look(exploration, "it is all touched", "explore", False, 2.0)
    notes.look(None, "it is all touched", "explore", True, 21.0)
    notes.look(None, "it is all touched", "explore", True, 22.0)
    assert lines(journal) == [
        "exploration: until 95% of the outline has been touched, 60 s at most",
        "exploration: 97% of the outline touched; it is all touched",
        "plan: the plan explore is complete; the palms are at rest",
    ]
    assert journal.entries[1].lasted_s == 20.0


def test_the_published_log_is_the_kept_one(journal):
    journal.add("state", "hold", "tracking -> hold: hold, by ann", who="ann")
    assert repr(entries_of(log_fields(journal.entries))) == repr(journal.entries)
