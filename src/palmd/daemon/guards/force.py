"""Limit of the pads' forces, one guard for every system whose pads measure force. Pure, safe in the loop.

A saturated reading means "at least the full scale": it counts as the full scale, and lasting saturation is a fault too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from palmd.events import PadLift, PadSample

MEAN = 0.2
"""Weight of a new reading in the running mean: pressures are noisy, and a shock of 50 ms does not count."""

STOP_FACTOR = 1.5
SATURATED_SHARE = 0.5


class ForceGuard:
    """Compares the running mean of each pad's force with its limit (N), and counts how often it is saturated."""

    def __init__(self, limits: Sequence[float], numbers: Sequence[int]) -> None:
        """`numbers` are the pads' numbers in the order of their limits."""
        self._limits = dict(zip(numbers, limits, strict=True))
        self._force = dict.fromkeys(numbers, 0.0)
        self._saturated = dict.fromkeys(numbers, 0.0)
        self._full_scale = dict.fromkeys(numbers, math.nan)

    def feed(self, event: PadSample | PadLift) -> None:
        """Take a reading; a pad without force readings is not judged."""
        pad = event.pad
        if isinstance(event, PadLift):
            self._force[pad] = self._saturated[pad] = 0.0
            return
        if event.at_least is not None:
            self._full_scale[pad] = event.at_least
        elif event.force is None:
            return
        force = event.at_least if event.force is None else event.force
        assert force is not None, "either the force or its lower bound is given"
        self._force[pad] += MEAN * (force - self._force[pad])
        self._saturated[pad] += MEAN * ((event.at_least is not None) - self._saturated[pad])

    def conditions(self, *, under_way: bool) -> Iterator[str]:
        """The codes that hold; `under_way`: a motion runs or is held, during which saturation alone is a fault."""
        for pad, limit in self._limits.items():
            force = self._force[pad]
            if force > limit or (under_way and self._saturated[pad] > SATURATED_SHARE):
                yield "force-limit"
            if force > STOP_FACTOR * limit:
                yield "force-excess"

    def evidence(self) -> str:
        """The force of each pad above its limit, in words."""
        found = []
        for pad, limit in self._limits.items():
            force = self._force[pad]
            if self._saturated[pad] > SATURATED_SHARE:
                found.append(
                    f"pad {pad} is saturated: at least {self._full_scale[pad]:.2f} N, its limit is {limit:.2f} N"
                )
            elif force > limit:
                found.append(f"pad {pad} measures {force:.2f} N, its limit is {limit:.2f} N")
        return "; ".join(found)
