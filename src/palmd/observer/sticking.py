"""Detection of dry friction from the pads' forces: averaged friction vanishes at low slip speeds, dry does not. Pure.

Palms that turn relative to each other make the object slip along at least one of them: outwards while they open,
inwards while they close. Friction then lowers or raises the sum of both pads' forces, which without friction is

    f1 + f2 = m g (sin φ12 + sin φ1)/sin φ2,

so that the forces of slowly turning palms show the amount of friction, whatever the object and its mass. Nothing sticks
on palms that are known to vibrate fast and strongly enough (`system.excitation`).
"""

from __future__ import annotations

import math

from palmd.events import PadSample, PalmMotion
from palmd.system.excitation import MOST_FRICTION, Excitation, Regime, friction_acceleration, regime
from palmd.system.mechanism import OPENING, PALMS, directions
from palmd.system.vibration import INDEPENDENT, Vibration

SLOWEST, SLOW = math.radians(0.5), math.radians(4.0)  # rad/s; range of opening rates that are used
FRESH_S, LIFTED_S = 0.04, 0.3  # largest age of a reading that is used; longest silence of a pad in contact
ENOUGH, KEPT = 12.0, 60.0  # slow ticks in each direction before a decision; ticks over which they are averaged
# Difference of ln(f1 + f2) between closing and opening palms: below LITTLE friction is negligible (coefficient 0.01);
# the object sticks above STICKS, until the difference falls below SLIPS.
LITTLE = 0.02
STICKS, SLIPS = 0.15, 0.08


class StickingWatch:
    """Detects from both pads' forces whether the object sticks. Safe inside the loop."""

    def __init__(self, vibration: Vibration = INDEPENDENT, gravity: float = 9.81) -> None:
        """`vibration`: of the palms; gravity in m/s²."""
        self._never = averages(vibration, gravity)
        self._last: dict[int, PadSample] = {}
        self._sticks = False
        self._ticks, self._mean = [0.0, 0.0], [0.0, 0.0]  # while the palms close, and while they open

    @property
    def contacts(self) -> tuple[float, ...] | None:
        """Contacts of a sticking object (m from the hinge), palm 1 first; None unless it is known to stick."""
        return tuple(self._last[palm].s for palm in PALMS) if self._sticks else None

    @property
    def frictionless(self) -> bool:
        """Whether the forces show that friction is negligible, so that nothing sticks on dry palms either."""
        closing, opening = self._mean
        return min(self._ticks) >= ENOUGH and abs(closing - opening) < LITTLE

    def feed(self, sample: PadSample) -> None:
        """Take a reading; a reading without a force is ignored."""
        if sample.force is not None and sample.force > 0.0:
            self._last[sample.pad] = sample

    def look(self, t: float, palms: PalmMotion | None) -> None:
        """Update the decision at `t` (s), once a tick."""
        if palms is None or len(self._last) < len(PALMS):
            return
        age = t - min(self._last[palm].t_sample for palm in PALMS)
        if age > LIFTED_S:
            self._last.clear()
            self._sticks, self._ticks = False, [0.0, 0.0]
            return
        (first, second), opens = directions(palms.angles), palms.rates[OPENING]
        if age > FRESH_S or not SLOWEST < abs(opens) < SLOW or not (0.0 < first < math.pi and 0.0 < second < math.pi):
            return
        total = sum(self._last[palm].force or 0.0 for palm in PALMS)
        weight = total * math.sin(palms.angles[OPENING]) / (math.sin(second) + math.sin(first))
        direction = int(opens > 0.0)
        self._ticks[direction] = min(self._ticks[direction] + 1.0, KEPT)
        self._mean[direction] += (math.log(weight) - self._mean[direction]) / self._ticks[direction]
        closing, opening = self._mean
        if min(self._ticks) >= ENOUGH:
            self._sticks = not self._never and closing - opening > (SLIPS if self._sticks else STICKS)


def averages(vibration: Vibration, gravity: float) -> bool:
    """Whether the palms are known to vibrate so that friction averages and no contact sticks, for any object."""
    if not vibration.vibrates or vibration.frequency is None or vibration.speed is None:
        return False
    shaken = Excitation(vibration.frequency, vibration.speed)
    return regime(shaken, friction_acceleration(MOST_FRICTION, gravity)) is Regime.AVERAGED
