"""Timeline of a run: state, faults, log and counters of the whole run, and every message near one instant.

Times are seconds of the daemon's monotonic clock, which is independent of the wall clock.
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
"""Time before and after the requested instant for which every tick is read."""

STATE_FAULT_S = 0.05
"""Faults that come up within this time after a change of state belong to it."""

CLOCK_STEP_S = 0.5
"""Change of wall clock minus monotonic clock that shows that the wall clock was set."""

_WINDOW_MARGIN_S = 0.2  # s; other messages are decoded only near a palm/state (10 Hz) of the window plus this margin


@dataclass(frozen=True, slots=True)
class StateChange:
    """One `palm/state` that differs from the one before: severities and hints by the codes of the active faults."""

    t: float
    state: str
    faults: dict[str, str]
    hints: dict[str, str]

    def with_severity(self, *severities: str) -> tuple[str, ...]:
        """The codes with one of these severities, in the order of publication."""
        return tuple(code for code, severity in self.faults.items() if severity in severities)


@dataclass(frozen=True, slots=True)
class Timeline:
    """A run from `begin` to `end`; `clock_steps`: times at which the wall clock was set, and by how much (s).

    states: changes of `palm/state`. loops: `palm/loop` messages. gaps: intervals in which published `palm/state`
    messages are missing. ending: why the recorder ended the file, a code of `palmd.record`, empty if unknown. `log` is
    empty for old runs without a log. `complete`: whether the recording was finished.
    """

    begin: float
    end: float
    complete: bool
    states: tuple[StateChange, ...]
    loops: tuple[tuple[float, Fields], ...]
    log: tuple[LogEntry, ...]
    clock_steps: tuple[tuple[float, float], ...]
    gaps: tuple[tuple[float, float], ...] = ()
    ending: str = ""

    def gap(self, begin: float, end: float) -> tuple[float, float] | None:
        """The first gap that overlaps the interval, None without one."""
        return next((gap for gap in self.gaps if gap[0] < end and gap[1] > begin), None)

    def at(self, t: float) -> StateChange | None:
        """The state at `t`, None before the first."""
        return next((change for change in reversed(self.states) if change.t <= t), None)

    def fault_duration(self, code: str, t: float) -> float:
        """How long (s) the fault that is active at `t` or shortly after lasted, up to the run's end; 0 for none."""
        later = [change for change in self.states if change.t >= t]
        began = next((change.t for change in later if code in change.faults and change.t - t < STATE_FAULT_S), self.end)
        return next((change.t for change in later if change.t > began and code not in change.faults), self.end) - began

    def counter_growth(self, t: float, *names: str) -> tuple[float, float, dict[str, float]] | None:
        """Growth of counters of `palm/loop` over the second around `t`: begin, end, growth by name.

        None if one of the two messages is missing.
        """
        for (t0, before), (t1, after) in pairwise(self.loops):
            if t0 <= t < t1:
                return t0, t1, {name: float(after.get(name, 0)) - float(before.get(name, 0)) for name in names}
        return None


@dataclass(slots=True)
class Closeup:
    """Every tick of a few seconds: `contact` and `motion` messages with tick times.

    `readings` and `lifts` (ends of contact) of each pad: pairs of tick time and sample time. `numbers`: sequence
    numbers of the motion messages, consecutive if none is missing. `rig_stalls` of an emulated rig: when it continued,
    and how long (s) it had stalled for lack of processor time.
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


def timeline_of(run: AnyRun) -> Timeline:
    """The timeline of a whole run; raises RunError if it holds no `palm/state`, OSError."""
    states: list[StateChange] = []
    loops: list[tuple[float, Fields]] = []
    log: list[LogEntry] = []
    steps: list[tuple[float, float]] = []
    gaps: list[tuple[float, float]] = []
    last_state: tuple[int, float] | None = None  # sequence number and time
    begin = end = clock_offset = None
    logged = -1  # sequence number of the last palm/log; a lower one follows a restart of the daemon
    for message, t in _messages_with_times(run, STATE.name, LOOP.name, LOG.name):
        fields = message.fields
        begin, end = t if begin is None else begin, t if end is None else max(t, end)
        ahead = float(fields["timestamp"]) - t
        if clock_offset is not None and abs(ahead - clock_offset) > CLOCK_STEP_S:
            steps.append((t, ahead - clock_offset))
        clock_offset = ahead
        if message.topic == STATE.name:
            if last_state is not None and message.sequence > last_state[0] + 1:
                gaps.append((last_state[1], t))
            last_state = message.sequence, t
            now = _state_change(fields, t)
            if not states or (states[-1].state, states[-1].faults) != (now.state, now.faults):
                states.append(now)
        elif message.topic == LOOP.name:
            loops.append((t, fields))
        else:
            known = log[-1].number if log and message.sequence > logged else -1
            logged = message.sequence
            log += [entry for entry in entries_of(fields) if entry.number > known]
    if begin is None or end is None or not states:
        raise RunError(f"{run.path}: holds no {STATE.name}: holds and stops cannot be analysed")
    ending = run.preface.metadata.get(END, {}).get("why", "")
    return Timeline(
        begin, end, run.complete, tuple(states), tuple(loops), tuple(log), tuple(steps), tuple(gaps), ending
    )


def closeup_of(run: AnyRun, t: float) -> Closeup:
    """Read every tick around `t`; raises RunError, OSError."""
    closeup, contact, motion = Closeup(), run.topics.contact.name, run.topics.motion.name
    wanted = contact, motion, run.topics.events.name, STALL.name
    for message, when in _messages_with_times(run, *wanted, window=(t - BEFORE_S, t + AFTER_S)):
        fields = message.fields
        if message.topic == contact:
            closeup.contact.append((when, fields))
        elif message.topic == motion:
            closeup.motion.append((when, fields))
            closeup.numbers.append(message.sequence)
        elif message.topic == STALL.name:
            closeup.rig_stalls.append((float(fields["t_s"]), float(fields["lasted_s"])))
        else:
            for source, t_sample in zip(fields["source"], fields["t_sample_s"], strict=True):
                kept = closeup.readings if source > 0 else closeup.lifts
                if source:
                    kept.setdefault(abs(int(source)), []).append((when, float(t_sample)))
    return closeup


def _messages_with_times(
    run: AnyRun, *topics: str, window: tuple[float, float] | None = None
) -> Iterator[tuple[RawMessage, float]]:
    """The messages of these topics with their tick times; outside the window they are not decoded."""
    near = window is None
    for message in run.messages(*topics, STATE.name):
        try:
            if window is not None and message.topic == STATE.name:
                t = message.fields["mono_ns"] * 1e-9
                near = window[0] - _WINDOW_MARGIN_S <= t <= window[1] + _WINDOW_MARGIN_S
            if near and message.topic in topics:
                t = message.fields["mono_ns"] * 1e-9
                if window is None or window[0] <= t <= window[1]:
                    yield message, t
        except (KeyError, TypeError, ValueError) as error:
            raise RunError(f"{run.path}: {message.topic}, message {message.sequence}: {error!r}") from None


def _state_change(fields: dict[str, Any], t: float) -> StateChange:
    codes = fields["faults"]
    return StateChange(
        t,
        fields["state"],
        dict(zip(codes, fields["severities"], strict=True)),
        dict(zip(codes, fields["hints"], strict=True)),
    )
