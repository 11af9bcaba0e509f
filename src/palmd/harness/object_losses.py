"""Whether the object is known at the end, and how often it was lost. Pure."""

from __future__ import annotations

import math

from palmd.daemon.journal import LOST_S

_TIMES = {0: "never", 1: "once", 2: "twice"}


class ObjectLosses:
    """Processes every estimate's time, validity and object number; memory does not grow with the duration.

    An object is lost if it had a valid estimate and then none for `LOST_S`, or if another one is started.
    """

    def __init__(self) -> None:
        self.losses = 0
        self._object = 0
        self._known = False
        self._t = self._t_valid = -math.inf

    def take(self, t: float, valid: bool, number: int) -> None:
        """Process an estimate at t (s)."""
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

    def summary(self) -> str:
        """State at the last estimate, such as "object 2 valid at the end, lost once"; empty if none was valid."""
        if not math.isfinite(self._t_valid):
            return ""
        ago = self._t - self._t_valid
        last = "valid" if self._known else f"not valid (last valid {ago:.1f} s before)"
        return f"object {self._object} {last} at the end, lost {_TIMES.get(self.losses, f'{self.losses} times')}"
