"""Check whether `palmd why` finds a provocation's cause from its recording alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from palmd.record.run import RunError, read_run
from palmd.report.timeline import timeline_of
from palmd.report.why import Explanation, answer
from tools.studies.fault_rows import FaultRow, Kill

AFTER_S = 0.05  # from the row's state or the first fault to the time of the question
UNNOTICED_S = 1.0  # the same from a cause without any fault
GOAL = 0.95  # share of right answers


@dataclass(frozen=True, slots=True)
class Judgement:
    """The answers as names of causes, with `palm/log` and without it, as in older runs.

    `recording`: the file, asked about time `at_s`; the cause was at `cause_s` (s since its first message). `spoilt`:
    something else had stopped the motion before the cause.
    """

    recording: str
    cause_s: float
    at_s: float
    with_log: str
    without_log: str
    sentence: str
    right: bool
    right_without_log: bool
    spoilt: bool = False


def asked_at(row: FaultRow, t_cause: float, noticed_s: float, came_s: float) -> float:
    """The time (s) that `palmd why` is asked about: after the row's state, after the first fault, or `UNNOTICED_S`.

    noticed_s, came_s: from the cause to the first fault and to the row's state; NaN for what did not happen.
    """
    if isinstance(row.act, Kill) and row.act.process == "daemon":
        return t_cause + UNNOTICED_S
    after = came_s if row.state != "tracking" else noticed_s
    return t_cause + (after + AFTER_S if math.isfinite(after) else UNNOTICED_S)


def ask(row: FaultRow, path: Path, t_cause: float, t: float) -> Judgement:
    """The answer for a recording at the time `t` (s, monotonic clock), judged by the row."""
    try:
        run = read_run(path)
        timeline = timeline_of(run)
        full, bare = (answer(run, each, t) for each in (timeline, replace(timeline, log=())))
    except (RunError, OSError) as error:
        return Judgement(path.name, math.nan, math.nan, "", "", str(error), False, False)
    before = timeline.at(t_cause)
    return Judgement(
        path.name,
        round(t_cause - timeline.begin, 3),
        round(t - timeline.begin, 3),
        full.cause.name,
        bare.cause.name,
        full.cause.sentence,
        _right(row, full),
        _right(row, bare),
        spoilt=before is None or before.state != "tracking",
    )


def _right(row: FaultRow, explanation: Explanation) -> bool:
    """Whether it names the row's cause; faults that do not stop motion must at least be mentioned."""
    evidence = " ".join(each.what for each in explanation.cause.evidence)
    mentioned = explanation.cause.kind != "nothing" or all(code in evidence for code in row.codes)
    return explanation.cause.name in row.why and mentioned


def enough(judged: Sequence[Judgement]) -> bool:
    """Whether the share of right answers reaches `GOAL`."""
    return sum(one.right for one in judged) >= GOAL * len(judged)
