"""The lifecycle's rules, stated independently of its implementation, for checking any run, explored or recorded. Pure.

Nothing follows set-points unless `arm` was granted; no plan runs unless `start` was granted; a stop fault ends
tracking, and a hold fault the motion, in the tick in which they occur; states change only along the table.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from itertools import groupby

from palmd.daemon.lifecycle import COMMANDED, TRANSITIONS, State
from palmd.faults import Severity
from palmd.messages import Fields, LogEntry, entries_of
from palmd.quantities import LOG, STATE
from palmd.record.run import AnyRun, RunError

PAIRS = frozenset((before, after) for (before, _), after in TRANSITIONS.items() if before is not after)
"""Pairs of states between which a single change is allowed."""

DONE = "done"


@dataclass(slots=True)
class Rules:
    """The commands granted so far; each method returns the rules that are broken, in words.

    `armed`: `arm` was granted since the arm was last not commanded; `started`: `start` or a jog was granted since then.
    """

    state: State | None = None
    armed: bool = False
    started: bool = False

    def tick(self, granted: Collection[str], changes: Iterable[tuple[State, State]]) -> list[str]:
        """One tick: the granted commands in their order, and the single changes of the state."""
        broken: list[str] = []
        self.armed |= "arm" in granted
        self.started |= bool({"start", "jog"} & {*granted})
        for before, after in changes:
            if self.state is not None and before is not self.state:
                broken.append(f"the state was {self.state}, and changed from {before}")
            if (before, after) not in PAIRS:
                broken.append(f"nothing leads from {before} to {after}")
            if after in COMMANDED and before not in COMMANDED and not self.armed:
                broken.append(f"from {before} to {after} without a granted arm")
            self.state = after
        if self.state not in COMMANDED and not (self.state is State.READY and "arm" in granted):
            self.armed = self.started = False
        return broken

    def look(self, state: State, severities: Collection[str], *, running: bool) -> list[str]:
        """The state at the end of a tick, the severities of the active faults, and whether a plan runs."""
        broken: list[str] = []
        if state in COMMANDED and Severity.STOP in severities:
            broken.append(f"the state is {state} while a stop fault stands")
        if state is State.TRACKING and Severity.HOLD in severities:
            broken.append("the state is tracking while a hold fault stands")
        if running and state not in COMMANDED:
            broken.append(f"a plan runs in state {state}")
        elif running and not self.started:
            broken.append("a plan runs without a granted start")
        return broken

    def unknown(self) -> None:
        """Entries are missing: anything may have been granted."""
        self.state, self.armed, self.started = None, True, True


@dataclass(frozen=True, slots=True)
class RulesReport:
    """Number of states and log entries checked in a recorded run, and the broken rules with times."""

    states: int
    entries: int
    broken: tuple[str, ...]


def check_run(run: AnyRun) -> RulesReport:
    """Apply the rules to a recorded run; raises RunError for invalid messages."""
    daemon_runs = [_DaemonRun()]
    last: dict[str, int] = {}
    for message in run.messages(STATE.name, LOG.name):
        if message.sequence < last.get(message.topic, 0):  # the daemon was started again
            daemon_runs.append(_DaemonRun())
            last.clear()
        last[message.topic] = message.sequence
        try:
            daemon_runs[-1].take(message.topic, message.fields)
        except (KeyError, TypeError, ValueError) as error:
            raise RunError(f"{run.path}: {message.topic}, message {message.sequence}: {error!r}") from None
    broken = tuple(what for daemon_run in daemon_runs for what in _broken_in(daemon_run))
    return RulesReport(
        sum(len(daemon_run.looks) for daemon_run in daemon_runs),
        sum(len(daemon_run.entries) for daemon_run in daemon_runs),
        broken,
    )


class _DaemonRun:
    """Log entries by number, and states, from one start of the daemon."""

    def __init__(self) -> None:
        self.entries: dict[int, LogEntry] = {}
        self.looks: list[tuple[float, State, list[str], bool]] = []
        self.t_logged = -math.inf  # the log does not yet cover later times

    def take(self, topic: str, fields: Fields) -> None:
        """Raises KeyError, TypeError, ValueError for an invalid message of that topic."""
        if topic == LOG.name:
            self.entries |= {entry.number: entry for entry in entries_of(fields)}
            self.t_logged = fields["mono_ns"] * 1e-9
        else:
            t, running = fields["mono_ns"] * 1e-9, bool(fields.get("running", False))
            self.looks.append((t, State(fields["state"]), fields["severities"], running))


def _broken_in(daemon_run: _DaemonRun) -> list[str]:
    entries = daemon_run.entries
    rules, broken = Rules(), list[str]()
    grouped = groupby((entries[number] for number in sorted(entries)), key=lambda entry: entry.t_s)
    ticks = [(t, list(some)) for t, some in grouped]
    number = 0
    for t, state, severities, running in daemon_run.looks:
        while ticks and ticks[0][0] <= t + 1e-6:
            t_tick, some = ticks.pop(0)
            if some[0].number != number:
                rules.unknown()
            number = some[-1].number + 1
            broken += [f"{t_tick:.3f} s: {what}" for what in rules.tick(_granted(some), _changes(some))]
        if t > daemon_run.t_logged:
            rules.unknown()
        broken += [f"{t:.3f} s: {what}" for what in rules.look(state, severities, running=running)]
    return broken


def _granted(entries: Iterable[LogEntry]) -> list[str]:
    return [entry.name for entry in entries if entry.kind == "command" and entry.text == DONE]


def _changes(entries: Iterable[LogEntry]) -> list[tuple[State, State]]:
    """The states' names precede the entry's first colon."""
    pairs = (entry.text.partition(":")[0].partition(" -> ") for entry in entries if entry.kind == "state")
    return [(State(before), State(after)) for before, _, after in pairs]
