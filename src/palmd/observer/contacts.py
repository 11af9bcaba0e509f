"""State of the two contacts by the pads' events: last readings, silence, lift-off."""

from __future__ import annotations

import math

from palmd.events import PadSample, PalmSample
from palmd.system.mechanism import PALMS

SILENCE_S = 0.1  # after a longer silence a pad does not confirm a contact
GONE_S = 0.4  # after a longer silence of a pad the object has left the palms


class Contacts:
    """The last reading of each pad since `clear`; safe inside the loop."""

    def __init__(self) -> None:
        self._last: dict[int, PadSample] = {}
        self._lifted: set[int] = set()
        self.resumed = -math.inf  # when a pad was last read again after a silence (s)
        self.least_recent = -math.inf  # the earlier of both pads' last readings (s); -inf until both have been read

    def read(self, sample: PadSample) -> None:
        """Take a reading; a reading older than the pad's last is ignored."""
        before = self.last_seen(sample.pad)
        if sample.t_sample < before:
            return
        if sample.t_sample - before > SILENCE_S:
            self.resumed = sample.t_sample
        self._last[sample.pad] = sample
        self.least_recent = min(map(self.last_seen, PALMS))
        self._lifted.discard(sample.pad)

    def lift(self, pad: int) -> None:
        """The pad reports that nothing touches it."""
        self._lifted.add(pad)

    def clear(self) -> None:
        """Forget all readings: the object has left the palms."""
        self._last.clear()
        self.least_recent = -math.inf

    def last(self, pad: int) -> PadSample | None:
        """The pad's latest reading by its own time."""
        return self._last.get(pad)

    def last_seen(self, pad: int) -> float:
        """Time of the pad's latest reading (s), -inf before the first."""
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
        """Whether the object has left the palms by `t` (s).

        True if a pad has been silent for longer than `GONE_S`, or if both pads are lifted for longer than `SILENCE_S`:
        after that no filter can predict the pose in which the object comes back.
        """
        lifted = len(self._lifted) == len(PALMS) and t - max(map(self.last_seen, PALMS)) > SILENCE_S
        return lifted or t - self.least_recent > GONE_S

    def read_lately(self, t: float) -> bool:
        """Whether both pads were read shortly before `t` (s)."""
        return t - self.least_recent < SILENCE_S

    def read_about(self, t: float) -> bool:
        """Whether both pads were read shortly before or after `t` (s)."""
        return all(abs(t - self.last_seen(pad)) < SILENCE_S for pad in PALMS)

    def touching(self, t: float) -> bool:
        """Whether both pads confirm a contact at `t` (s)."""
        return not self._lifted and self.read_lately(t)


def finite(event: PadSample | PalmSample) -> bool:
    """Whether every number in the event is finite."""
    total = event.s + (event.force or 0.0) if isinstance(event, PadSample) else sum(event.values)
    return math.isfinite(event.t_sample + total)  # a sum is finite only if all its terms are
