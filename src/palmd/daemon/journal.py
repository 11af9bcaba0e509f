"""The journal behind `palm/log`: a bounded list of entries, and the classes that write them. Pure, safe in the loop.

State and faults are polled; only changes are recorded, with their cause, including conditions that ended before the
next poll.
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
"""An identical entry within this time is not repeated, except for faults that hold or stop."""

LOST_S = 0.5
"""An object that was known is lost after this time without a valid estimate."""

_GRAVE = (Severity.HOLD, Severity.STOP)


class Journal:
    """The last `LOG_ENTRIES` entries; `count` is how many there have been. New entries get the time `t` (s)."""

    def __init__(self) -> None:
        self.t = 0.0
        self.count = 0
        self._entries: deque[LogEntry] = deque(maxlen=LOG_ENTRIES)

    @property
    def entries(self) -> tuple[LogEntry, ...]:
        """All kept entries, oldest first."""
        return tuple(self._entries)

    def add(
        self, kind: LogKind, name: str, text: str, *,
        severity: str = "", who: str = "", lasted_s: float = math.nan, code: str = "",
    ) -> None:  # fmt: skip
        """Add an entry, unless it repeats the one before within `SAME_S`."""
        if len(text) > TEXT_LONGEST:
            text = f"{text[: TEXT_LONGEST - 1]}…"
        last = self._entries[-1] if self._entries else None
        content = (kind, name, who, text)
        if last is not None and self.t - last.t_s < SAME_S and (last.kind, last.name, last.who, last.text) == content:
            return
        self._entries.append(LogEntry(self.count, self.t, kind, name, severity, who, lasted_s, text, code))
        self.count += 1


class FaultNotes:
    """Records faults when they come up, with their evidence, and when they end, with their duration."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._active: tuple[Fault, ...] = ()
        self._since: dict[str, float] = {}  # begin of each fault that has been recorded
        self._t_recorded: dict[str, float] = {}

    def look(self, active: tuple[Fault, ...], t: float, evidence: Callable[[str, float], tuple[str, str]]) -> None:
        """Record changes of the `active` faults at `t` (s); `evidence(code, t)`: in words, and as a code."""
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
            if fault.severity not in _GRAVE and t - self._t_recorded.get(code, -math.inf) < SAME_S:
                continue
            self._since[code] = self._t_recorded[code] = t
            reason, finding = evidence(code, t)
            text = f"{fault.text}: {reason}" if reason else fault.text
            self._journal.add("fault", code, text, severity=fault.severity, code=finding)


class ObjectNotes:
    """Records when an object is new, known, lost, and known again."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._number = 0
        self._known = False
        self._t_valid = self._t_known = -math.inf

    def look(
        self, number: int, valid: bool, untouched: Sequence[int], t: float, because: Callable[[], str] = str
    ) -> None:
        """Update at `t` (s): the object's number, whether its estimate is valid, the pads without contact.

        `because` gives the limit that the estimate failed.
        """
        add = self._journal.add
        if number != self._number:
            self._lose(f"object {number} has been started", t)
            self._number, self._t_valid = number, -math.inf
            add("object", "begun", f"object {number} is new: it touches all pads")
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
    """Records rig constants that the readings begin or cease to contradict."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._before: npt.NDArray[np.bool_] = np.zeros(len(RIG_NAMES), dtype=np.bool_)

    def look(self, contradicted: FloatArray, findings: Callable[[], Sequence[str]]) -> None:
        """Update with a smoother's answer.

        contradicted: number of σ by which each constant is contradicted. `findings` returns descriptions of the errors.
        """
        now = contradicted != 0.0
        if np.array_equal(now, self._before):
            return
        for i in np.flatnonzero(now & ~self._before):
            sigmas = f"readings contradict the configuration by {abs(contradicted[i]):.1f}σ"
            self._journal.add("rig", RIG_NAMES[i], f"{sigmas}: {'; '.join(findings())}")
        for i in np.flatnonzero(self._before & ~now):
            self._journal.add("rig", RIG_NAMES[i], "readings no longer contradict the configuration")
        self._before = now


class MotionNotes:
    """Records the begin and end of explorations, and the end of a plan."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._exploration: Exploration | None = None
        self._t_started = math.nan
        self._over = False

    def look(self, exploration: Exploration | None, reason: str, plan: str, over: bool, t: float) -> None:
        """Update at `t` (s).

        exploration: the one under way. reason: why the last one ended. over: whether the plan is complete.
        """
        if exploration is not self._exploration:
            if self._exploration is not None:
                share = self._exploration.coverage
                done = f"{share:.0%} of the outline touched; " if math.isfinite(share) else ""
                self._journal.add("exploration", "over", f"{done}{reason}", lasted_s=t - self._t_started)
            self._exploration, self._t_started = exploration, t
            if exploration is not None:
                goal = exploration.goal
                wanted = f"until {goal.coverage:.0%} of the outline has been touched, {goal.time_limit_s:g} s at most"
                self._journal.add("exploration", "begun", wanted)
        if over and not self._over:
            self._journal.add("plan", "over", f"the plan {plan} is complete; the palms are at rest")
        self._over = over
