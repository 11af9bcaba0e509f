"""Do the pads feel more than they may? One guard for every system whose pads tell forces. Pure, safe in the loop.

A saturated reading says "at least the full scale": it counts as that, and by itself where it lasts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from palmd.events import PadLift, PadSample

MEAN = 0.2
"""Share of a new reading in the running mean: a pad's pressure is noisy, and a bump of 50 ms is none."""

STOP_FACTOR = 1.5
SATURATED_SHARE = 0.5


class ForceGuard:
    """Running means of each pad's force against its limit (N), and of how often it is saturated."""

    def __init__(self, limits: Sequence[float], numbers: Sequence[int]) -> None:
        """`numbers` are the pads', in the order of their limits."""
        self._limits = dict(zip(numbers, limits, strict=True))
        self._force = dict.fromkeys(numbers, 0.0)
        self._saturated = dict.fromkeys(numbers, 0.0)
        self._full = dict.fromkeys(numbers, math.nan)

    def feed(self, event: PadSample | PadLift) -> None:
        """Take a reading; a pad that tells no force at all is not judged."""
        pad = event.pad
        if isinstance(event, PadLift):
            self._force[pad] = self._saturated[pad] = 0.0
            return
        if event.at_least is not None:
            self._full[pad] = event.at_least
        elif event.force is None:
            return
        force = event.at_least if event.force is None else event.force
        assert force is not None, "one of both is told"
        self._force[pad] += MEAN * (force - self._force[pad])
        self._saturated[pad] += MEAN * ((event.at_least is not None) - self._saturated[pad])

    def conditions(self, *, under_way: bool) -> Iterator[str]:
        """The codes that hold; `under_way`: a motion that runs or is held, during which saturation alone counts."""
        for pad, limit in self._limits.items():
            force = self._force[pad]
            if force > limit or (under_way and self._saturated[pad] > SATURATED_SHARE):
                yield "force-limit"
            if force > STOP_FACTOR * limit:
                yield "force-excess"

    def evidence(self) -> str:
        """What each pad feels that feels too much, in words."""
        found = []
        for pad, limit in self._limits.items():
            force = self._force[pad]
            if self._saturated[pad] > SATURATED_SHARE:
                found.append(
                    f"pad {pad} is saturated: it feels at least {self._full[pad]:.2f} N, its limit is {limit:.2f} N"
                )
            elif force > limit:
                found.append(f"pad {pad} feels {force:.2f} N, its limit is {limit:.2f} N")
        return "; ".join(found)
