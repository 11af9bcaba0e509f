"""Events in the order of their own times, each with the bank as it was before it, so that late ones can be fused."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass

from palmd.events import FloatArray, PadSample, PalmSample
from palmd.observer.bank import Bank, Snapshot

EVENTS = 24  # that can be undone


@dataclass(slots=True)
class Fused:
    """An event at its time `t` (s), and what was before it: the bank's time, when its blocks faded, its state."""

    t: float
    event: PadSample | PalmSample
    t_before: float
    t_faded: FloatArray
    before: Snapshot


@dataclass(slots=True)
class Now:
    """Up to when the bank has been moved, and when the present track was begun (s)."""

    t: float = -math.inf
    t_start: float = math.inf


class History:
    """The last `EVENTS` fused events of one bank at a time; its memory is allotted at the beginning."""

    def __init__(self, banks: Iterable[Bank]):
        """`banks` are all that will ever be used."""
        self._memory = {id(bank): [bank.blank() for _ in range(EVENTS)] for bank in banks}
        self.now = Now()
        self._fused: list[Fused] = []
        self._spare: list[Snapshot] = []

    def use(self, bank: Bank) -> None:
        """From now on the events are fused into `bank`; none can be undone yet."""
        self._fused = []
        self._spare = self._memory[id(bank)].copy()

    def clear(self) -> None:
        """What came before can no longer be undone."""
        self._spare += [entry.before for entry in self._fused]
        self._fused.clear()

    def snapshot(self) -> Snapshot:
        """Memory for the bank's present state; the oldest event can then no longer be undone."""
        return self._spare.pop() if self._spare else self._fused.pop(0).before

    def add(self, entry: Fused) -> None:
        """An event that is being fused, the latest so far."""
        self._fused.append(entry)

    def undo(self, t: float, bank: Bank) -> list[Fused] | None:
        """Set the bank back to before the events later than `t` (s), which are forgotten and returned in order.

        None, and nothing is changed, when it is too late for that.
        """
        at = bisect_right([entry.t for entry in self._fused], t)
        undone = self._fused[at:]
        if not undone or t < undone[0].t_before:
            return None
        bank.restore(undone[0].before)
        del self._fused[at:]
        self._spare += [entry.before for entry in undone]
        return undone
