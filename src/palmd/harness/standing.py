"""Whether the object is known at the end, and how often it was lost. Pure: what is published in, words out."""

from __future__ import annotations

import math

from palmd.daemon.journal import LOST_S

_TIMES = {0: "never", 1: "once", 2: "twice"}


class Standing:
    """Takes every estimate's time, validity and object number; needs the same memory however long a run is.

    An object is lost when it had a valid estimate and then has none for `LOST_S`, or when another one is begun.
    """

    def __init__(self) -> None:
        self.losses = 0
        self._object = 0
        self._known = False
        self._t = self._t_valid = -math.inf

    def take(self, t: float, valid: bool, number: int) -> None:
        """One estimate, at t (s)."""
        self._t = t
        if self._known and (number != self._object or (not valid and t - self._t_valid > LOST_S)):
            self.losses += 1
            self._known = False
        self._object = number
        if valid:
            self._known, self._t_valid = True, t

    @property
    def known(self) -> bool:
        """Whether the object has a valid estimate, or had one less than `LOST_S` ago."""
        return self._known

    def words(self) -> str:
        """How it stands at the last estimate: "object 2 valid at the end, lost once"; empty before any was valid."""
        if not math.isfinite(self._t_valid):
            return ""
        ago = self._t - self._t_valid
        last = "valid" if self._known else f"not valid (last valid {ago:.1f} s before)"
        return f"object {self._object} {last} at the end, lost {_TIMES.get(self.losses, f'{self.losses} times')}"
