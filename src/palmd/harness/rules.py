"""The lifecycle's rules, told apart from the lifecycle: what must hold of any run, explored or recorded. Pure.

Nothing follows set-points unless `arm` was granted, no plan runs unless `start` was, a stop fault ends tracking and a
hold fault the motion in the tick that they come up in, and states change only along the table.
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
"""From which state to which one a single change may lead."""

DONE = "done"


@dataclass(slots=True)
class Rules:
    """What has been granted so far; each method returns what it breaks, in words.

    `armed`: since the arm was last not commanded, `arm` was granted; `told`: since then `start` or a jog was.
    """

    state: State | None = None
    armed: bool = False
    told: bool = False

    def tick(self, granted: Collection[str], changes: Iterable[tuple[State, State]]) -> list[str]:
        """One tick: the commands that were granted, in their order, and the single changes of the state."""
        broken: list[str] = []
        self.armed |= "arm" in granted
        self.told |= bool({"start", "jog"} & {*granted})
        for before, after in changes:
            if self.state is not None and before is not self.state:
                broken.append(f"the state was {self.state}, and changed from {before}")
            if (before, after) not in PAIRS:
                broken.append(f"nothing leads from {before} to {after}")
            if after in COMMANDED and before not in COMMANDED and not self.armed:
                broken.append(f"from {before} to {after} though nobody armed")
            self.state = after
        if self.state not in COMMANDED and not (self.state is State.READY and "arm" in granted):
            self.armed = self.told = False
        return broken

    def look(self, state: State, severities: Collection[str], *, running: bool) -> list[str]:
        """The state at a tick's end, how grave the faults are that stand, and whether a plan runs."""
        broken: list[str] = []
        if state in COMMANDED and Severity.STOP in severities:
            broken.append(f"the state is {state} while a stop fault stands")
        if state is State.TRACKING and Severity.HOLD in severities:
            broken.append("the state is tracking while a hold fault stands")
        if running and state not in COMMANDED:
            broken.append(f"a plan runs in state {state}")
        elif running and not self.told:
            broken.append("a plan runs though nobody gave start")
        return broken

    def unknown(self) -> None:
        """Entries are missing: anything may have been granted."""
        self.state, self.armed, self.told = None, True, True


@dataclass(frozen=True, slots=True)
class Kept:
    """How many states and log entries of a recorded run were looked at, and the rules that were broken, with times."""

    states: int
    entries: int
    broken: tuple[str, ...]


def kept_by(run: AnyRun) -> Kept:
    """The rules applied to a recorded run; raises RunError for messages that are none."""
    lives = [_Life()]
    last: dict[str, int] = {}
    for message in run.messages(STATE.name, LOG.name):
        if message.sequence < last.get(message.topic, 0):  # the daemon was started again
            lives.append(_Life())
            last.clear()
        last[message.topic] = message.sequence
        try:
            lives[-1].take(message.topic, message.fields)
        except (KeyError, TypeError, ValueError) as error:
            raise RunError(f"{run.path}: {message.topic}, message {message.sequence}: {error!r}") from None
    broken = tuple(what for life in lives for what in _broken_in(life))
    return Kept(sum(len(life.looks) for life in lives), sum(len(life.entries) for life in lives), broken)


class _Life:
    """What one start of the daemon has told: log entries by number, and states."""

    def __init__(self) -> None:
        self.entries: dict[int, LogEntry] = {}
        self.looks: list[tuple[float, State, list[str], bool]] = []
        self.t_logged = -math.inf  # of what came later the log has not told yet

    def take(self, topic: str, fields: Fields) -> None:
        """Raises KeyError, TypeError, ValueError for what is no message of that topic."""
        if topic == LOG.name:
            self.entries |= {entry.number: entry for entry in entries_of(fields)}
            self.t_logged = fields["mono_ns"] * 1e-9
        else:
            t, running = fields["mono_ns"] * 1e-9, bool(fields.get("running", False))
            self.looks.append((t, State(fields["state"]), fields["severities"], running))


def _broken_in(life: _Life) -> list[str]:
    entries = life.entries
    rules, broken = Rules(), list[str]()
    told = groupby((entries[number] for number in sorted(entries)), key=lambda entry: entry.t_s)
    ticks = [(t, list(some)) for t, some in told]
    number = 0
    for t, state, severities, running in life.looks:
        while ticks and ticks[0][0] <= t + 1e-6:
            t_tick, some = ticks.pop(0)
            if some[0].number != number:
                rules.unknown()
            number = some[-1].number + 1
            broken += [f"{t_tick:.3f} s: {what}" for what in rules.tick(_granted(some), _changes(some))]
        if t > life.t_logged:
            rules.unknown()
        broken += [f"{t:.3f} s: {what}" for what in rules.look(state, severities, running=running)]
    return broken


def _granted(entries: Iterable[LogEntry]) -> list[str]:
    return [entry.name for entry in entries if entry.kind == "command" and entry.text == DONE]


def _changes(entries: Iterable[LogEntry]) -> list[tuple[State, State]]:
    """The states' names stand before the entry's first colon."""
    told = (entry.text.partition(":")[0].partition(" -> ") for entry in entries if entry.kind == "state")
    return [(State(before), State(after)) for before, _, after in told]
