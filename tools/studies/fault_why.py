"""Whether `palmd why` tells a provocation's cause, asked of its recording alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from palmd.record.run import RunError, read_run
from palmd.report.timeline import timeline_of
from palmd.report.why import Explanation, answer
from tools.studies.fault_rows import FaultRow, Kill

AFTER_S = 0.05  # after it came to its state, or was noticed
UNNOTICED_S = 1.0  # after a cause of which nothing is noticed
GOAL = 0.95


@dataclass(frozen=True, slots=True)
class Judgement:
    """What was answered, with the log and without it as in runs of before there was one, by the causes' names.

    `recording` is the file that was asked about `at_s`; the cause was at `cause_s` (s since its first message). A
    provocation is spoilt when something else had held the motion by then.
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
    """When (s) the question is about: once it stands, once it is noticed, or a while after what nobody notices.

    noticed_s, came_s: from the cause to the first word of it, and to the row's state; NaN for what did not come.
    """
    if isinstance(row.act, Kill) and row.act.process == "daemon":
        return t_cause + UNNOTICED_S
    after = came_s if row.state != "tracking" else noticed_s
    return t_cause + (after + AFTER_S if math.isfinite(after) else UNNOTICED_S)


def ask(row: FaultRow, path: Path, t_cause: float, t: float) -> Judgement:
    """The answer of the recording in a file about the time `t` (s, monotonic clock), judged by the row."""
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


def _right(row: FaultRow, told: Explanation) -> bool:
    """Whether it is the row's cause; what holds nothing must at least be mentioned."""
    said = " ".join(each.what for each in told.cause.evidence)
    mentioned = told.cause.kind != "nothing" or all(code in said for code in row.codes)
    return told.cause.name in row.why and mentioned


def enough(judged: Sequence[Judgement]) -> bool:
    """Whether the share of right answers is as it must be."""
    return sum(one.right for one in judged) >= GOAL * len(judged)
