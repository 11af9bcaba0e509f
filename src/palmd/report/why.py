"""`palmd why`: what made a recorded run hold or stop, in plain words with the evidence, from the recording alone."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

from palmd.faults import TABLE
from palmd.messages import LogEntry
from palmd.record import SUFFIX
from palmd.record.damage import damage_text
from palmd.record.index import BEING_WRITTEN_S
from palmd.record.run import AnyRun, RunError, read_any_run
from palmd.report.causes import RunCase, StopCause, of_break, of_damage, of_end, of_fault, of_no_fault, of_tracking
from palmd.report.course import TOGETHER_S, Course, StateChange, closeup_of, course_of

_COMMANDED = ("tracking", "hold")
_ACTS = {"hold": ("hold", "stop"), "fault": ("stop",), "ready": (), "idle": ()}
_HAPPENED = {"hold": "the motion was held", "fault": "the arm was stopped", "ready": "the arm was stopped",
             "idle": "the rig was gone"}  # fmt: skip
ENDINGS = ("died", "cut", "goes-on", "recorder-ended")
DAMAGED_HINT = "palmd runs recover keeps what can be read in a new file; look for a fault of the disk"
OTHERS = 8
"""So many of the other times are listed."""

RECENT_S = 0.25
"""So long after a fault has gone, it is told of motion that goes on."""

END_S, GAP_S, LATE_S = 0.05, 0.5, 1.0
"""So long before its end, the end is what a question is about; so much may be missing before the next file; and so
long after it, a question is not about it any more."""


@dataclass(frozen=True, slots=True)
class Interruption:
    """The state that ended the motion, what stood before, and until when (s) it did not go on; infinite for the end.

    `hints` tell what to do, by the codes of the faults that act in that state.
    """

    before: StateChange
    now: StateChange
    until: float
    hints: dict[str, str]

    @property
    def codes(self) -> tuple[str, ...]:
        """Of those faults."""
        return tuple(self.hints)


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why it stood at `t` (s since the run's first message), or that it did not.

    recording: the file that tells it, the one that was asked or one that goes on from it. happened: in words, what was
    done, and `since` when (s) until when. cause: what lies behind. standing: the faults that acted and how long (s)
    each stood; hint: what to do. others: the other times at which it was held or stopped.
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
    """Why it was held or stopped at `at` (s since the first message); without a time: the last time by a fault.

    Raises RunError for a run that tells no state, or ended before that time; OSError.
    """
    course = course_of(run)
    return answer(run, course, None if at is None else course.begin + at)


def answer(run: AnyRun, course: Course, t: float | None) -> Explanation:
    """The same of a run whose course is known; `t` on its clock."""
    found = tuple(stops(course))
    stop = _asked(course, found, t)
    others = tuple((each.now.t - course.begin, _in_short(each)) for each in found if each is not stop)
    if stop is None:
        return _not_stopped(run, course, course.end if t is None else t, others)
    hole = course.hole(stop.before.t, stop.now.t) if run.damage.damaged else None
    if hole is not None and stop.now.t - hole[1] < TOGETHER_S:
        return _unknown(run, course, hole, t, others)
    case = RunCase(course, closeup_of(run, stop.now.t), run.config, run.topics)
    cause = of_fault(case, stop.codes, stop.now.t) if stop.codes else of_no_fault(case, stop.before, stop.now)
    return Explanation(
        run.path.name,
        (stop.now.t if t is None else t) - course.begin,
        stop.now.state,
        _HAPPENED.get(stop.now.state, stop.now.state),
        stop.now.t - course.begin,
        stop.until - course.begin,
        cause,
        tuple((code, course.stood(code, stop.now.t)) for code in stop.codes),
        "; ".join(dict.fromkeys(stop.hints.values())),
        others,
    )


def stops(course: Course) -> Iterator[Interruption]:
    """Every time that what was commanded came to stand, or a fault came up while it stood."""
    for number, (before, now) in enumerate(pairwise(course.told), 1):
        came_to_stand = before.state in _COMMANDED and now.state in ("ready", "idle")
        if before.state != now.state and (now.state in ("hold", "fault") or came_to_stand):
            after = (later.t for later in course.told[number + 1 :] if later.state == "tracking")
            acting = _ACTS.get(now.state, ())
            hints = {
                code: told.hints[code]
                for told in course.told[number:]
                if told.t - now.t < TOGETHER_S
                for code in told.grave(*acting)
            } or {entry.name: TABLE[entry.name].hint for entry in _passed(course, acting, before.t, now.t)}
            yield Interruption(before, now, next(after, math.inf), hints)


def _passed(course: Course, acting: tuple[str, ...], begin: float, end: float) -> Iterator[LogEntry]:
    """The faults that act and have come and gone between two looks at what stands: the log alone tells of them."""
    for entry in course.log:
        near = max(begin, end - TOGETHER_S) < entry.t_s <= end
        if near and entry.kind == "fault" and entry.severity in acting and entry.name in TABLE:
            yield entry


def lines(answer: Explanation) -> Iterator[str]:
    """The answer in plain words."""
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
        yield f"{'' if number else 'fault':10}{code}, stood for {seconds:.2f} s" + (f": {text}" if text else "")
    if answer.hint:
        yield f"do        {answer.hint}"
    for number, (t, what) in enumerate(answer.others[-OTHERS:]):
        yield f"{'' if number else 'besides':10}--at {t:.2f}  {what}"
    if len(answer.others) > OTHERS:
        yield f"{'':10}and {len(answer.others) - OTHERS} before"


def _asked(course: Course, found: tuple[Interruption, ...], t: float | None) -> Interruption | None:
    """The stop that is asked about: that in which `t` lies; None where it went on, or broke off.

    Without a time: the last one by a fault, else the last one at all; none where the run ends in motion.
    """
    if t is None:
        if course.told[-1].state == "tracking":
            return None
        by_fault = [stop for stop in found if stop.codes]
        return next(reversed(by_fault or found), None)
    lies = [stop for stop in found if stop.now.t <= t < stop.until]
    return lies[-1] if lies and t <= course.end + LATE_S else None


def _not_stopped(run: AnyRun, course: Course, t: float, others: tuple[tuple[float, str], ...]) -> Explanation:
    told = course.at(t) or course.told[0]
    case = RunCase(course, closeup_of(run, min(t, course.end)), run.config, run.topics)
    rel = t - course.begin
    hole = course.hole(t, t) if run.damage.damaged else None
    if hole is not None:
        return _unknown(run, course, hole, t, others)
    lost_end = run.damage.cut or (run.damage.lost and run.damage.lost[-1].before_ns is None)
    if t >= course.end - END_S and told.state in _COMMANDED and lost_end:
        return _unknown(run, course, (course.end, math.inf), t, others)
    if t >= course.end - END_S and told.state in _COMMANDED:
        later = _successor(run)
        if later is None:
            cause = of_end(case, being_written=_is_being_written(run))
        else:
            goes_on = course_of(later)
            if t >= goes_on.begin - GAP_S and t > course.end:
                return answer(later, goes_on, t)
            cause = of_break(case, later.path.name, goes_on.log)
        since = course.end - course.begin
        return Explanation(run.path.name, rel, told.state, "the recording ends", since, math.inf, cause, (), "", others)
    if t > course.end + LATE_S:
        end = f"{course.end - course.begin:.2f} s"
        raise RunError(f"{run.path}: there is nothing of {rel:.2f} s in it: it ends after {end}, in state {told.state}")
    if told.state == "tracking":
        recent = [each for each in course.told if t - RECENT_S < each.t <= t]
        faults = {code: severity for each in (told, *recent) for code, severity in each.faults.items()}
        return Explanation(run.path.name, rel, told.state, "", rel, rel, of_tracking(case, faults, t), (), "", others)
    cause = StopCause("before", "", f"it had not been commanded yet: the state was {told.state}")
    grave = told.grave("hold", "stop")
    if grave:
        cause = of_fault(case, grave, told.t)
    standing = tuple((code, course.stood(code, told.t)) for code in grave)
    return Explanation(
        run.path.name, rel, told.state, "", rel, rel, cause, standing, "; ".join(told.hints[c] for c in grave), others
    )


def _unknown(
    run: AnyRun, course: Course, hole: tuple[float, float], t: float | None, others: tuple[tuple[float, str], ...]
) -> Explanation:
    """What happened in a part of the file that is damaged."""
    begin, end = (each - course.begin for each in hole)
    cause = of_damage(
        damage_text(run.damage, run.layout.begin_ns), f"{begin:.2f} s", "its end" if math.isinf(end) else f"{end:.2f} s"
    )
    told = course.at(hole[0])
    state = told.state if told is not None else ""
    rel = begin if t is None else t - course.begin
    return Explanation(run.path.name, rel, state, "the file is damaged", begin, end, cause, (), DAMAGED_HINT, others)


def _is_being_written(run: AnyRun) -> bool:
    with contextlib.suppress(OSError):
        return time.time() - run.path.stat().st_mtime < BEING_WRITTEN_S
    return False


def _successor(run: AnyRun) -> AnyRun | None:
    """The recording beside it that says it goes on from this one; None without any."""
    for path in sorted(run.path.parent.glob(f"*{SUFFIX}")):
        if path.name > run.path.name:
            with contextlib.suppress(RunError):
                later = read_any_run(path)
                if later.metadata.get("continues") == run.path.name:
                    return later
    return None


def _in_short(stop: Interruption) -> str:
    return f"{_HAPPENED.get(stop.now.state, stop.now.state)}: {', '.join(stop.codes) or 'no fault'}"
