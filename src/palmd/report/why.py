"""Root-cause analysis for `palmd why`: what made a recorded run hold or stop, as text with evidence."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

from palmd.faults import TABLE
from palmd.messages import LogEntry
from palmd.record import SUFFIX
from palmd.record.damage import damage_text
from palmd.record.index import BEING_WRITTEN_S
from palmd.record.run import AnyRun, RunError, read_any_run
from palmd.report.causes import (
    RunCase,
    StopCause,
    of_continuation,
    of_damage,
    of_end,
    of_fault,
    of_no_fault,
    of_tracking,
)
from palmd.report.timeline import STATE_FAULT_S, StateChange, Timeline, closeup_of, timeline_of

_COMMANDED = ("tracking", "hold")
_ACTING = {"hold": ("hold", "stop"), "fault": ("stop",), "ready": (), "idle": ()}
_EVENT_TEXT = {"hold": "the motion was held", "fault": "the arm was stopped", "ready": "the arm was stopped",
             "idle": "the rig was lost"}  # fmt: skip
ENDINGS = ("died", "cut", "goes-on", "recorder-ended")
DAMAGED_HINT = "palmd runs recover writes the readable part to a new file; check the disk"
MAX_OTHERS = 8
"""Most other interruptions that are listed."""

RECENT_S = 0.25
"""A fault that ended less than this long ago is still reported for continuing motion."""

NEAR_END_S, CONTINUATION_GAP_S, AFTER_END_S = 0.05, 0.5, 1.0
"""A time in the last `NEAR_END_S` of a run asks for its end; one up to `CONTINUATION_GAP_S` before the next recording
belongs to that; times more than `AFTER_END_S` after the end are rejected."""


@dataclass(frozen=True, slots=True)
class Interruption:
    """A hold or stop: the state before, the state `now` that ended the motion, and the time (s) until it resumed.

    `until` is infinite if it did not resume. `hints`: what to do, by the codes of the faults that acted.
    """

    before: StateChange
    now: StateChange
    until: float
    hints: dict[str, str]

    @property
    def codes(self) -> tuple[str, ...]:
        """Codes of the faults that acted."""
        return tuple(self.hints)


@dataclass(frozen=True, slots=True)
class Explanation:
    """The result for time `t` (s since the run's first message): why the motion was interrupted, or that it was not.

    recording: the analysed file, the requested one or one that continues it. happened: what happened, as text, from
    `since` to `until` (s). cause: the root cause. standing: the faults that acted, with durations (s). hint: what to
    do. others: the other interruptions.
    """

    recording: str
    t: float
    state: str
    happened: str
    since: float
    until: float
    cause: StopCause
    standing: tuple[tuple[str, float], ...]
    hint: str
    others: tuple[tuple[float, str], ...]


def explain(run: AnyRun, at: float | None = None) -> Explanation:
    """Explain the hold or stop at `at` (s since the first message); without a time, the last one caused by a fault.

    Raises RunError for a run without states, or one that ended before that time; OSError.
    """
    timeline = timeline_of(run)
    return answer(run, timeline, None if at is None else timeline.begin + at)


def answer(run: AnyRun, timeline: Timeline, t: float | None) -> Explanation:
    """As `explain` for a run with known timeline; `t` (s) is on its clock."""
    found = tuple(stops(timeline))
    interruption = _requested_stop(timeline, found, t)
    others = tuple((each.now.t - timeline.begin, _short_text(each)) for each in found if each is not interruption)
    if interruption is None:
        return _not_stopped(run, timeline, timeline.end if t is None else t, others)
    gap = timeline.gap(interruption.before.t, interruption.now.t) if run.damage.damaged else None
    if gap is not None and interruption.now.t - gap[1] < STATE_FAULT_S:
        return _damaged(run, timeline, gap, t, others)
    case = RunCase(timeline, closeup_of(run, interruption.now.t), run.config, run.topics)
    cause = (
        of_fault(case, interruption.codes, interruption.now.t)
        if interruption.codes
        else of_no_fault(case, interruption.before, interruption.now)
    )
    return Explanation(
        run.path.name,
        (interruption.now.t if t is None else t) - timeline.begin,
        interruption.now.state,
        _EVENT_TEXT.get(interruption.now.state, interruption.now.state),
        interruption.now.t - timeline.begin,
        interruption.until - timeline.begin,
        cause,
        tuple((code, timeline.fault_duration(code, interruption.now.t)) for code in interruption.codes),
        "; ".join(dict.fromkeys(interruption.hints.values())),
        others,
    )


def stops(timeline: Timeline) -> Iterator[Interruption]:
    """Every interruption of a run: motion that ended, or a fault while it was held."""
    for number, (before, now) in enumerate(pairwise(timeline.states), 1):
        motion_ended = before.state in _COMMANDED and now.state in ("ready", "idle")
        if before.state != now.state and (now.state in ("hold", "fault") or motion_ended):
            after = (later.t for later in timeline.states[number + 1 :] if later.state == "tracking")
            acting = _ACTING.get(now.state, ())
            hints = {
                code: change.hints[code]
                for change in timeline.states[number:]
                if change.t - now.t < STATE_FAULT_S
                for code in change.with_severity(*acting)
            } or {entry.name: TABLE[entry.name].hint for entry in _brief_faults(timeline, acting, before.t, now.t)}
            yield Interruption(before, now, next(after, math.inf), hints)


def _brief_faults(timeline: Timeline, acting: tuple[str, ...], begin: float, end: float) -> Iterator[LogEntry]:
    """Faults that acted so briefly that only the log shows them, not `palm/state`."""
    for entry in timeline.log:
        near = max(begin, end - STATE_FAULT_S) < entry.t_s <= end
        if near and entry.kind == "fault" and entry.severity in acting and entry.name in TABLE:
            yield entry


def lines(answer: Explanation) -> Iterator[str]:
    """The explanation as lines of text."""
    cause = answer.cause
    if answer.happened and answer.cause.kind in ENDINGS:
        yield f"{answer.recording}: at {answer.since:.2f} s {answer.happened} (state {answer.state})"
    elif answer.happened:
        until = "to the end" if math.isinf(answer.until) else f"until {answer.until:.2f} s"
        yield f"{answer.recording}: at {answer.since:.2f} s {answer.happened}, {until} (state {answer.state})"
    else:
        yield f"{answer.recording}: at {answer.t:.2f} s, state {answer.state}"
    yield f"why       {cause.sentence}"
    for number, each in enumerate(cause.evidence):
        yield f"{'' if number else 'evidence':10}{each.where}: {each.what}"
    for number, (code, seconds) in enumerate(answer.standing):
        text = TABLE[code].text if code in TABLE else ""
        yield f"{'' if number else 'fault':10}{code}, active for {seconds:.2f} s" + (f": {text}" if text else "")
    if answer.hint:
        yield f"do        {answer.hint}"
    for number, (t, what) in enumerate(answer.others[-MAX_OTHERS:]):
        yield f"{'' if number else 'besides':10}--at {t:.2f}  {what}"
    if len(answer.others) > MAX_OTHERS:
        yield f"{'':10}and {len(answer.others) - MAX_OTHERS} before"


def _requested_stop(timeline: Timeline, found: tuple[Interruption, ...], t: float | None) -> Interruption | None:
    """The interruption at `t`; None if the motion continued there, or the run had ended.

    Without a time: the last one by a fault, else the last one; None if the run ends in motion.
    """
    if t is None:
        if timeline.states[-1].state == "tracking":
            return None
        by_fault = [interruption for interruption in found if interruption.codes]
        return next(reversed(by_fault or found), None)
    matching = [interruption for interruption in found if interruption.now.t <= t < interruption.until]
    return matching[-1] if matching and t <= timeline.end + AFTER_END_S else None


def _not_stopped(run: AnyRun, timeline: Timeline, t: float, others: tuple[tuple[float, str], ...]) -> Explanation:
    current = timeline.at(t) or timeline.states[0]
    case = RunCase(timeline, closeup_of(run, min(t, timeline.end)), run.config, run.topics)
    rel = t - timeline.begin
    explained = partial(Explanation, run.path.name, rel, current.state)
    gap = timeline.gap(t, t) if run.damage.damaged else None
    if gap is not None:
        return _damaged(run, timeline, gap, t, others)
    if t >= timeline.end - NEAR_END_S and current.state in _COMMANDED:
        if run.damage.cut or (run.damage.lost and run.damage.lost[-1].before_ns is None):
            return _damaged(run, timeline, (timeline.end, math.inf), t, others)
        later = _successor(run)
        if later is None:
            cause = of_end(case, being_written=_is_being_written(run))
        else:
            continuation = timeline_of(later)
            if t >= continuation.begin - CONTINUATION_GAP_S and t > timeline.end:
                return answer(later, continuation, t)
            cause = of_continuation(case, later.path.name, continuation.log)
        return explained("the recording ends", timeline.end - timeline.begin, math.inf, cause, (), "", others)
    if t > timeline.end + AFTER_END_S:
        end = f"{timeline.end - timeline.begin:.2f} s"
        raise RunError(f"{run.path}: no data at {rel:.2f} s: the run ends after {end}, in state {current.state}")
    if current.state == "tracking":
        recent = [each for each in timeline.states if t - RECENT_S < each.t <= t]
        faults = {code: severity for each in (current, *recent) for code, severity in each.faults.items()}
        return explained("", rel, rel, of_tracking(case, faults, t), (), "", others)
    cause = StopCause("before", "", f"the arm had not been commanded yet: the state was {current.state}")
    acting = current.with_severity("hold", "stop")
    if acting:
        cause = of_fault(case, acting, current.t)
    standing = tuple((code, timeline.fault_duration(code, current.t)) for code in acting)
    return explained("", rel, rel, cause, standing, "; ".join(current.hints[c] for c in acting), others)


def _damaged(
    run: AnyRun, timeline: Timeline, gap: tuple[float, float], t: float | None, others: tuple[tuple[float, str], ...]
) -> Explanation:
    """The explanation for a time in a damaged part of the file."""
    begin, end = (each - timeline.begin for each in gap)
    until = "its end" if math.isinf(end) else f"{end:.2f} s"
    cause = of_damage(damage_text(run.damage, run.layout.begin_ns), f"{begin:.2f} s", until)
    before = timeline.at(gap[0])
    state = before.state if before is not None else ""
    rel = begin if t is None else t - timeline.begin
    return Explanation(run.path.name, rel, state, "the file is damaged", begin, end, cause, (), DAMAGED_HINT, others)


def _is_being_written(run: AnyRun) -> bool:
    with contextlib.suppress(OSError):
        return time.time() - run.path.stat().st_mtime < BEING_WRITTEN_S
    return False


def _successor(run: AnyRun) -> AnyRun | None:
    """The recording in the same folder that continues this one; None without any."""
    for path in sorted(run.path.parent.glob(f"*{SUFFIX}")):
        if path.name > run.path.name:
            with contextlib.suppress(RunError):
                later = read_any_run(path)
                if later.metadata.get("continues") == run.path.name:
                    return later
    return None


def _short_text(each: Interruption) -> str:
    return f"{_EVENT_TEXT.get(each.now.state, each.now.state)}: {', '.join(each.codes) or 'no fault'}"
