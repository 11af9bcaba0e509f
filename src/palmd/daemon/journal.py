"""What has happened, as `palm/log` tells it: a bounded list, and who notices. Pure, and safe in the loop.

State and faults are looked at again and again; here is told once what has changed, and why, also when it is over by
the next look.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.faults import Fault, Severity
from palmd.messages import LogEntry, LogKind
from palmd.motion.exploration import Exploration
from palmd.quantities import LOG_ENTRIES
from palmd.system.rig_constants import RIG_NAMES

TEXT_LONGEST = 400
SAME_S = 1.0
"""The same again within so long is not told twice; grave faults always are."""

LOST_S = 0.5
"""Without a valid estimate for so long, an object that was known is lost."""

_GRAVE = (Severity.HOLD, Severity.STOP)


class Journal:
    """The last `LOG_ENTRIES` entries; `count` is how many there have been. `t` (s) is the time that entries get."""

    def __init__(self) -> None:
        self.t = 0.0
        self.count = 0
        self._entries: deque[LogEntry] = deque(maxlen=LOG_ENTRIES)

    @property
    def entries(self) -> tuple[LogEntry, ...]:
        """All that are kept, the oldest first."""
        return tuple(self._entries)

    def add(
        self, kind: LogKind, name: str, text: str, *, severity: str = "", who: str = "", lasted_s: float = math.nan
    ) -> None:
        """Tell of something; what equals the entry before it within `SAME_S` is left out."""
        if len(text) > TEXT_LONGEST:
            text = f"{text[: TEXT_LONGEST - 1]}…"
        last = self._entries[-1] if self._entries else None
        said = (kind, name, who, text)
        if last is not None and self.t - last.t_s < SAME_S and (last.kind, last.name, last.who, last.text) == said:
            return
        self._entries.append(LogEntry(self.count, self.t, kind, name, severity, who, lasted_s, text))
        self.count += 1


class FaultNotes:
    """Tells of faults as they come, with what speaks for them, and as they go, with how long they stood."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._active: tuple[Fault, ...] = ()
        self._since: dict[str, float] = {}  # of what has been told
        self._told: dict[str, float] = {}

    def look(self, active: tuple[Fault, ...], t: float, evidence: Callable[[str, float], str]) -> None:
        """The faults that stand at `t` (s); `evidence` tells what speaks for a code."""
        if active is self._active:
            return
        self._active = active
        standing = {fault.code: fault for fault in active}
        for code in [code for code in self._since if code not in standing]:
            lasted = t - self._since.pop(code)
            self._journal.add("fault", code, f"over after {lasted:.2f} s", lasted_s=lasted)
        for code, fault in standing.items():
            if code in self._since:
                continue
            if fault.severity not in _GRAVE and t - self._told.get(code, -math.inf) < SAME_S:
                continue
            self._since[code] = self._told[code] = t
            why = evidence(code, t)
            self._journal.add("fault", code, f"{fault.text}: {why}" if why else fault.text, severity=fault.severity)


class ObjectNotes:
    """Tells when an object is begun, known, lost, known again."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._number = 0
        self._known = False
        self._t_valid = self._t_known = -math.inf

    def look(
        self, number: int, valid: bool, untouched: Sequence[int], t: float, because: Callable[[], str] = str
    ) -> None:
        """At `t` (s): the object's number, whether its estimate is valid, the pads without contact.

        `because` says which limit the estimate failed.
        """
        add = self._journal.add
        if number != self._number:
            self._lose(f"object {number} was begun", t)
            self._number, self._t_valid = number, -math.inf
            add("object", "begun", f"object {number} is begun: both pads feel something")
        if valid:
            if not self._known:
                again = f" again, after {t - self._t_valid:.1f} s" if math.isfinite(self._t_valid) else ""
                self._known, self._t_known = True, t
                add("object", "known", f"object {number} is known{again}: its estimate is valid")
            self._t_valid = t
        elif self._known and t - self._t_valid > LOST_S:
            pads = " and ".join(map(str, untouched))
            why = f"no contact on pad {pads}" if untouched else because() or "the observer gives no reason"
            self._lose(f"no valid estimate for {LOST_S:g} s: {why}", t)

    def _lose(self, why: str, t: float) -> None:
        if self._known:
            self._known = False
            self._journal.add("object", "lost", f"object {self._number} is lost: {why}", lasted_s=t - self._t_known)


class RigNotes:
    """Tells of the rig's constants that readings begin, or cease, to contradict."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._before: npt.NDArray[np.bool_] = np.zeros(len(RIG_NAMES), dtype=np.bool_)

    def look(self, contradicted: FloatArray, said: Callable[[], Sequence[str]]) -> None:
        """By how many sigmas each is contradicted; `said` tells in words what is off. With each answer."""
        now = contradicted != 0.0
        if np.array_equal(now, self._before):
            return
        for i in np.flatnonzero(now & ~self._before):
            sigmas = f"readings contradict the configuration by {abs(contradicted[i]):.1f} sigmas"
            self._journal.add("rig", RIG_NAMES[i], f"{sigmas}: {'; '.join(said())}")
        for i in np.flatnonzero(self._before & ~now):
            self._journal.add("rig", RIG_NAMES[i], "readings contradict the configuration no longer")
        self._before = now


class MotionNotes:
    """Tells when an exploration begins and ends, and that a plan has come to its end."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._exploration: Exploration | None = None
        self._t_begun = math.nan
        self._over = False

    def look(self, exploration: Exploration | None, reason: str, plan: str, over: bool, t: float) -> None:
        """At `t` (s): the exploration in hand, why the last one ended, the plan, and whether that is `over`."""
        if exploration is not self._exploration:
            if self._exploration is not None:
                share = self._exploration.coverage
                done = f"{share:.0%} of the outline touched; " if math.isfinite(share) else ""
                self._journal.add("exploration", "over", f"{done}{reason}", lasted_s=t - self._t_begun)
            self._exploration, self._t_begun = exploration, t
            if exploration is not None:
                goal = exploration.goal
                wanted = f"until {goal.coverage:.0%} of the outline is touched, {goal.time_limit_s:g} s at most"
                self._journal.add("exploration", "begun", wanted)
        if over and not self._over:
            self._journal.add("plan", "over", f"the plan {plan} has run its course; the palms stand")
        self._over = over
