"""Events in the order of their own times, each with the bank's state before it, so that late events can be fused."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass

from palmd.events import FloatArray, PadSample, PalmSample
from palmd.observer.bank import Bank, Snapshot

EVENTS = 24  # number of events that can be undone


@dataclass(slots=True)
class Fused:
    """An event at its time `t` (s), with the bank's time, last forgetting times and state before it."""

    t: float
    event: PadSample | PalmSample
    t_before: float
    t_faded: FloatArray
    before: Snapshot


@dataclass(slots=True)
class Now:
    """The bank's time, and when the present track was started (s)."""

    t: float = -math.inf
    t_start: float = math.inf


class History:
    """The last `EVENTS` fused events of one bank at a time; all memory is allocated at construction."""

    def __init__(self, banks: Iterable[Bank]):
        """`banks`: all banks that will be used."""
        self._memory = {id(bank): [bank.blank() for _ in range(EVENTS)] for bank in banks}
        self.now = Now()
        self._fused: list[Fused] = []
        self._spare: list[Snapshot] = []

    def use(self, bank: Bank) -> None:
        """Fuse into `bank` from now on, with an empty history."""
        self._fused = []
        self._spare = self._memory[id(bank)].copy()

    def clear(self) -> None:
        """Empty the history: no earlier event can be undone."""
        self._spare += [entry.before for entry in self._fused]
        self._fused.clear()

    def snapshot(self) -> Snapshot:
        """Memory for the bank's present state, taken from the oldest event if none is free."""
        return self._spare.pop() if self._spare else self._fused.pop(0).before

    def add(self, entry: Fused) -> None:
        """Append an event that is being fused, the latest so far."""
        self._fused.append(entry)

    def undo(self, t: float, bank: Bank) -> list[Fused] | None:
        """Restore the bank to before the events later than `t` (s), remove these and return them in order.

        Returns None and changes nothing if `t` is before the history.
        """
        at = bisect_right([entry.t for entry in self._fused], t)
        undone = self._fused[at:]
        if not undone or t < undone[0].t_before:
            return None
        bank.restore(undone[0].before)
        del self._fused[at:]
        self._spare += [entry.before for entry in undone]
        return undone
