"""What a run tells of its course: state, faults, log and counters throughout, and everything near one instant. Pure
but for the reading.

Times are seconds of the daemon's monotonic clock, which no setting of the wall clock moves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from palmd.messages import Fields, LogEntry, entries_of
from palmd.quantities import LOG, LOOP, STALL, STATE
from palmd.record import END, RunError
from palmd.record.mcapfile import RawMessage
from palmd.record.run import AnyRun

BEFORE_S, AFTER_S = 3.0, 2.0
"""How much of the ticks is looked at, around the instant that is asked about."""

TOGETHER_S = 0.05
"""Faults that come within so long after the state has changed belong to it."""

STEP_S = 0.5
"""A wall clock that goes so much apart from the monotonic one has been set."""

_UNDECODED = 0.2  # s: how near palm/state, which comes at 10 Hz, tells where in the run a message is


@dataclass(frozen=True, slots=True)
class StateChange:
    """One `palm/state` that differs from the one before: severities and hints by the codes of the faults that stand."""

    t: float
    state: str
    faults: dict[str, str]
    hints: dict[str, str]

    def grave(self, *severities: str) -> tuple[str, ...]:
        """The codes of these severities, in the table's order."""
        return tuple(code for code, severity in self.faults.items() if severity in severities)


@dataclass(frozen=True, slots=True)
class Course:
    """A run's course from `begin` to `end`; `clock_steps` are times at which the wall clock was set, and by how much.

    holes: from when to when no `palm/state` is in the file though some were published. ending: why the recorder ended
    the file, as in `palmd.record`, empty where it does not say. `log` is empty for runs of before there was one.
    `complete` says whether the recording got its end.
    """

    begin: float
    end: float
    complete: bool
    told: tuple[StateChange, ...]
    loops: tuple[tuple[float, Fields], ...]
    log: tuple[LogEntry, ...]
    clock_steps: tuple[tuple[float, float], ...]
    holes: tuple[tuple[float, float], ...] = ()
    ending: str = ""

    def hole(self, begin: float, end: float) -> tuple[float, float] | None:
        """The first hole between two times, if there is any."""
        return next((hole for hole in self.holes if hole[0] < end and hole[1] > begin), None)

    def at(self, t: float) -> StateChange | None:
        """What was told last up to `t`, None before the first."""
        return next((told for told in reversed(self.told) if told.t <= t), None)

    def stood(self, code: str, t: float) -> float:
        """How long (s) the fault stood that stands at `t` or comes soon after, up to the run's end; 0 for none."""
        later = [told for told in self.told if told.t >= t]
        came = next((told.t for told in later if code in told.faults and told.t - t < TOGETHER_S), self.end)
        return next((told.t for told in later if told.t > came and code not in told.faults), self.end) - came

    def gained(self, t: float, *names: str) -> tuple[float, float, dict[str, float]] | None:
        """By how much counters of `palm/loop` grew over the second in which `t` lies: from, to, growth by name.

        None where one of the two messages is missing.
        """
        for (t0, before), (t1, after) in pairwise(self.loops):
            if t0 <= t < t1:
                return t0, t1, {name: float(after.get(name, 0)) - float(before.get(name, 0)) for name in names}
        return None


@dataclass(slots=True)
class Closeup:
    """Every tick of a few seconds: `contact` and `motion` by the ticks' times.

    `readings` of each pad and `lifts`, the ends of its contacts, are told by when they were fed and when they were
    true; `numbers` are the ticks' own, which count on where none is missing. `rig_stalls` of an emulated rig: when it
    went on, and how long (s) it had stood still for want of a processor.
    """

    contact: list[tuple[float, Fields]] = field(default_factory=list)
    motion: list[tuple[float, Fields]] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    readings: dict[int, list[tuple[float, float]]] = field(default_factory=dict)
    lifts: dict[int, list[tuple[float, float]]] = field(default_factory=dict)
    rig_stalls: list[tuple[float, float]] = field(default_factory=list)

    def last_motion(self, t: float) -> Fields:
        """The last `palm/motion` up to `t`; empty before the first."""
        return next((fields for when, fields in reversed(self.motion) if when <= t), {})


def course_of(run: AnyRun) -> Course:
    """The whole run's; raises RunError where it holds no `palm/state`, OSError."""
    told: list[StateChange] = []
    loops: list[tuple[float, Fields]] = []
    log: list[LogEntry] = []
    steps: list[tuple[float, float]] = []
    holes: list[tuple[float, float]] = []
    looked: tuple[int, float] | None = None  # number and time of the last palm/state
    begin = end = apart = None
    logged = -1  # number of the last message; one that is lower is of another start of the daemon
    for message, t in _timed(run, STATE.name, LOOP.name, LOG.name):
        fields = message.fields
        begin, end = t if begin is None else begin, t if end is None else max(t, end)
        ahead = float(fields["timestamp"]) - t
        if apart is not None and abs(ahead - apart) > STEP_S:
            steps.append((t, ahead - apart))
        apart = ahead
        if message.topic == STATE.name:
            if looked is not None and message.sequence > looked[0] + 1:
                holes.append((looked[1], t))
            looked = message.sequence, t
            now = _told(fields, t)
            if not told or (told[-1].state, told[-1].faults) != (now.state, now.faults):
                told.append(now)
        elif message.topic == LOOP.name:
            loops.append((t, fields))
        else:
            known = log[-1].number if log and message.sequence > logged else -1
            logged = message.sequence
            log += [entry for entry in entries_of(fields) if entry.number > known]
    if begin is None or end is None or not told:
        raise RunError(f"{run.path}: holds no {STATE.name}: it does not tell what held or stopped it")
    ending = run.preface.metadata.get(END, {}).get("why", "")
    return Course(begin, end, run.complete, tuple(told), tuple(loops), tuple(log), tuple(steps), tuple(holes), ending)


def closeup_of(run: AnyRun, t: float) -> Closeup:
    """Every tick around `t`; raises RunError, OSError."""
    found, contact, motion = Closeup(), run.topics.contact.name, run.topics.motion.name
    wanted = contact, motion, run.topics.events.name, STALL.name
    for message, when in _timed(run, *wanted, window=(t - BEFORE_S, t + AFTER_S)):
        fields = message.fields
        if message.topic == contact:
            found.contact.append((when, fields))
        elif message.topic == motion:
            found.motion.append((when, fields))
            found.numbers.append(message.sequence)
        elif message.topic == STALL.name:
            found.rig_stalls.append((float(fields["t_s"]), float(fields["lasted_s"])))
        else:
            for source, t_sample in zip(fields["source"], fields["t_sample_s"], strict=True):
                kept = found.readings if source > 0 else found.lifts
                if source:
                    kept.setdefault(abs(int(source)), []).append((when, float(t_sample)))
    return found


def _timed(run: AnyRun, *topics: str, window: tuple[float, float] | None = None) -> Iterator[tuple[RawMessage, float]]:
    """The messages of these topics with their ticks' times; outside the window they are not even unpacked."""
    near = window is None
    for message in run.messages(*topics, STATE.name):
        try:
            if window is not None and message.topic == STATE.name:
                t = message.fields["mono_ns"] * 1e-9
                near = window[0] - _UNDECODED <= t <= window[1] + _UNDECODED
            if near and message.topic in topics:
                t = message.fields["mono_ns"] * 1e-9
                if window is None or window[0] <= t <= window[1]:
                    yield message, t
        except (KeyError, TypeError, ValueError) as error:
            raise RunError(f"{run.path}: {message.topic}, message {message.sequence}: {error!r}") from None


def _told(fields: dict[str, Any], t: float) -> StateChange:
    codes = fields["faults"]
    return StateChange(
        t,
        fields["state"],
        dict(zip(codes, fields["severities"], strict=True)),
        dict(zip(codes, fields["hints"], strict=True)),
    )
