"""Does friction stick? What dithers rubs the less the slower it slips, what sticks as hard at any speed. Pure.

Palms that turn against each other make the object slip along one of them at least: outwards as they open, inwards as
they close. Friction then lowers or raises what both pads feel together, which without it would be

    f1 + f2 = m g (sin φ12 + sin φ1)/sin φ2,

so that the forces alone tell how much of it there is when palms turn slowly, whatever the object is and weighs. Palms
that are known to vibrate fast and hard enough let nothing stick (`system.excitation`).
"""

from __future__ import annotations

import math

from palmd.events import PadSample, PalmMotion
from palmd.system.excitation import MOST_FRICTION, Excitation, Regime, friction_acceleration, regime
from palmd.system.mechanism import OPENING, PALMS, directions
from palmd.system.vibration import INDEPENDENT, Vibration

SLOWEST, SLOW = math.radians(0.5), math.radians(4.0)  # rad/s, of the opening
FRESH_S, LIFTED_S = 0.04, 0.3  # a reading that counts; a pad silent for longer has let go
ENOUGH, KEPT = 12.0, 60.0  # slow ticks of each sense before anything is said; over how many they are averaged
LITTLE = 0.02  # of the same: a coefficient of friction of 0.01, whose friction moves no estimate
STICKS, SLIPS = 0.15, 0.08  # ln(f1 + f2) as the palms close less that as they open: above sticks, below does not


class StickingWatch:
    """Tells from both pads' forces whether an object sticks, and where its contacts are then. Safe in the loop."""

    def __init__(self, vibration: Vibration = INDEPENDENT, gravity: float = 9.81) -> None:
        """Of palms that vibrate so, under gravity (m/s²)."""
        self._never = averages(vibration, gravity)
        self._last: dict[int, PadSample] = {}
        self._sticks = False
        self._ticks, self._mean = [0.0, 0.0], [0.0, 0.0]  # while the palms close, and while they open

    @property
    def contacts(self) -> tuple[float, ...] | None:
        """Where they are (m from the hinge), palm 1 first; None of an object that does not stick, or may not."""
        return tuple(self._last[palm].s for palm in PALMS) if self._sticks else None

    @property
    def frictionless(self) -> bool:
        """Whether the forces show that there is hardly any friction: then nothing sticks on dry palms either."""
        closing, opening = self._mean
        return min(self._ticks) >= ENOUGH and abs(closing - opening) < LITTLE

    def feed(self, sample: PadSample) -> None:
        """Take a reading; one without a force says nothing."""
        if sample.force is not None and sample.force > 0.0:
            self._last[sample.pad] = sample

    def look(self, t: float, palms: PalmMotion | None) -> None:
        """Judge anew at `t` (s), once a tick."""
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
        felt = sum(self._last[palm].force or 0.0 for palm in PALMS)
        share = felt * math.sin(palms.angles[OPENING]) / (math.sin(second) + math.sin(first))
        sense = int(opens > 0.0)
        self._ticks[sense] = min(self._ticks[sense] + 1.0, KEPT)
        self._mean[sense] += (math.log(share) - self._mean[sense]) / self._ticks[sense]
        closing, opening = self._mean
        if min(self._ticks) >= ENOUGH:
            self._sticks = not self._never and closing - opening > (SLIPS if self._sticks else STICKS)


def averages(vibration: Vibration, gravity: float) -> bool:
    """Whether palms are known to vibrate so that no contact sticks, whatever lies on them."""
    if not vibration.vibrates or vibration.frequency is None or vibration.speed is None:
        return False
    shaken = Excitation(vibration.frequency, vibration.speed)
    return regime(shaken, friction_acceleration(MOST_FRICTION, gravity)) is Regime.AVERAGED
