"""From measured latency to what should be changed."""

from __future__ import annotations

import pytest

from palmd.doctor.decision_tree import branches, lines
from palmd.doctor.lateness import Case

GOOD, LATE = [0.1] * 100, [5.0] * 100


def changes(*cases: Case) -> list[str]:
    return [each.change for each in branches(cases) if each.change]


def test_a_punctual_machine_needs_no_change() -> None:
    cases = [Case(name, GOOD, 0, GOOD) for name in ("idle", "every core busy", "disk busy")]
    assert changes(*cases) == []
    assert lines(tuple(branches(cases)))[-1].endswith("nothing to change")


def test_an_idle_machine_that_wakes_late_ends_the_questions() -> None:
    (change,) = changes(Case("idle", LATE, 3, LATE), Case("disk busy", LATE, 3, LATE))
    assert "PREEMPT_RT" in change


def test_late_ticks_on_a_machine_that_wakes_in_time_are_a_matter_of_priority() -> None:
    (change,) = changes(Case("idle", LATE, 3, GOOD), Case("disk busy", LATE, 3, GOOD))
    assert "priority" in change


@pytest.mark.parametrize(
    ("busy", "words"),
    [("every core busy", "isolcpus"), ("disk busy", "another disk"), ("network busy", "interrupts"),
     ("recorder and page", "another machine")],
)  # fmt: skip
def test_each_kind_of_load_has_its_change(busy: str, words: str) -> None:
    (change,) = changes(Case("idle", GOOD, 0, GOOD), Case(busy, LATE, 9, GOOD))
    assert words in change
