"""What the pads tell of the two contacts: which pad is read, which is silent or lifted, and since when."""

from __future__ import annotations

import math

from palmd.events import PadSample, PalmSample
from palmd.system.mechanism import PALMS

SILENCE_S = 0.1  # a pad silent for longer does not vouch for a contact
GONE_S = 0.4  # a pad silent for longer: the object has left the palms


class Contacts:
    """The last reading of each pad since `clear`; safe inside the loop."""

    def __init__(self) -> None:
        self._last: dict[int, PadSample] = {}
        self._lifted: set[int] = set()
        self.resumed = -math.inf  # when a pad was last read again after a silence (s)
        self.quietest = -math.inf  # when the pad that is silent for longer was read last (s), -inf before both were

    def read(self, sample: PadSample) -> None:
        """Take a reading; one that is older than the pad's last changes nothing."""
        before = self.last_seen(sample.pad)
        if sample.t_sample < before:
            return
        if sample.t_sample - before > SILENCE_S:
            self.resumed = sample.t_sample
        self._last[sample.pad] = sample
        self.quietest = min(map(self.last_seen, PALMS))
        self._lifted.discard(sample.pad)

    def lift(self, pad: int) -> None:
        """The pad says that nothing touches it."""
        self._lifted.add(pad)

    def clear(self) -> None:
        """The object has left: nothing read until now counts any more."""
        self._last.clear()
        self.quietest = -math.inf

    def last(self, pad: int) -> PadSample | None:
        """The pad's latest reading by its own time."""
        return self._last.get(pad)

    def last_seen(self, pad: int) -> float:
        """When that was (s), -inf before the first."""
        sample = self._last.get(pad)
        return -math.inf if sample is None else sample.t_sample

    def all(self) -> list[PadSample]:
        """The latest reading of each pad that has been read, in the order of the palms."""
        return [self._last[pad] for pad in PALMS if pad in self._last]

    @property
    def any(self) -> bool:
        """Whether any pad has been read."""
        return bool(self._last)

    def gone(self, t: float) -> bool:
        """Whether the object has left the palms by `t` (s): a pad is silent for too long, or both say so and stay so.

        What has flown for `SILENCE_S` lies there in no pose that a filter could foresee, however soon it is back.
        """
        lifted = len(self._lifted) == len(PALMS) and t - max(map(self.last_seen, PALMS)) > SILENCE_S
        return lifted or t - self.quietest > GONE_S

    def read_lately(self, t: float) -> bool:
        """Whether both pads were read shortly before `t` (s)."""
        return t - self.quietest < SILENCE_S

    def read_about(self, t: float) -> bool:
        """Whether both pads were read shortly before or after `t` (s)."""
        return all(abs(t - self.last_seen(pad)) < SILENCE_S for pad in PALMS)

    def touching(self, t: float) -> bool:
        """Whether both pads vouch for a contact at `t` (s)."""
        return not self._lifted and self.read_lately(t)


def finite(event: PadSample | PalmSample) -> bool:
    """Whether every number that the event tells is one."""
    told = event.s + (event.force or 0.0) if isinstance(event, PadSample) else sum(event.values)
    return math.isfinite(event.t_sample + told)  # a sum is so only if all its terms are
