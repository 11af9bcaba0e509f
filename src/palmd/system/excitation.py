"""Friction law for an excitation of the palms, by its frequency and speed (docs/theory/vibration.md). Pure.

Motion of the plan is slow: friction is dry, the object sticks and slips, and models follow it step by step. A vibration
can be averaged if it is much faster than the object's motion and strong enough that no contact sticks during a
reversal. Anything in between must be resolved step by step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

PLAN_MOST_HZ = 20.0
"""Highest frequency that a plan may move the palms with; up to here it counts as motion."""
SLOW_HZ = 5.0
"""Bandwidth of the motion of an object between palms: it rocks at 1 to 5 Hz."""
FASTER = 10.0
"""Factor by which a vibration must be faster than that to be averaged."""
STICKS = 1.9
"""2πfV over the acceleration due to friction, below which a contact sticks while its slip reverses."""
FRICTION_SHARE = 2.4
"""That acceleration over μg: 1.3 on average for ellipses between palms at rest, below this value for 95 % of them."""
MOST_FRICTION = 0.3
"""Coefficient of friction for which a vibration should be strong enough; objects with more are rare."""
RESONANT = (0.5, 2.0)
"""Range of frequency over resonance in which normal forces follow friction up to 2.6-fold, or with the wrong sign."""


class Regime(StrEnum):
    """How a model must treat an excitation."""

    AVERAGED = "averaged"
    """Average over it: the fractions of time of each slip sign matter."""
    STEPS = "resolved in substeps"
    """Resolve it: it is neither slow nor both fast and strong."""
    DRY = "dry"
    """Treat it as motion with dry friction, which sticks."""


@dataclass(frozen=True, slots=True)
class Excitation:
    """A harmonic motion of the palms along themselves: frequency (Hz), amplitude of its speed (m/s)."""

    frequency: float
    speed: float

    @property
    def acceleration(self) -> float:
        """Amplitude of the acceleration, 2πfV (m/s²)."""
        return 2.0 * math.pi * self.frequency * self.speed


def friction_acceleration(mu: float, gravity: float) -> float:
    """Largest acceleration of a contact along the palm due to friction (m/s²)."""
    return FRICTION_SHARE * mu * gravity


def sticks(excitation: Excitation, friction: float) -> bool:
    """Whether a contact sticks during the excitation, with an acceleration `friction` due to friction (m/s²)."""
    return excitation.acceleration <= STICKS * friction


def regime(excitation: Excitation, friction: float, slow_hz: float = SLOW_HZ) -> Regime:
    """How a model must treat the excitation; slow_hz: bandwidth of the object's own motion."""
    if excitation.frequency <= PLAN_MOST_HZ:
        return Regime.DRY
    fast = excitation.frequency >= FASTER * slow_hz
    return Regime.AVERAGED if fast and not sticks(excitation, friction) else Regime.STEPS


def least_speed(frequency: float, friction: float) -> float:
    """Smallest amplitude of speed (m/s) at which a vibration of this frequency keeps contacts from sticking."""
    return STICKS * friction / (2.0 * math.pi * frequency)


def resonance_hz(stiffness: float, mass: float) -> float:
    """Resonance frequency f_c of a mass (kg) on a contact or mount of this stiffness (N/m)."""
    return math.sqrt(stiffness / mass) / (2.0 * math.pi)


def resonates(frequency: float, resonance: float) -> bool:
    """Whether a frequency is so close to a resonance that the response of the normal forces is unknown."""
    return RESONANT[0] < frequency / resonance < RESONANT[1]


def swung(amplitude_rad: float, frequency: float, reach: float) -> Excitation:
    """Excitation of a contact at distance `reach` (m) from the hinge by palms that oscillate about it."""
    return Excitation(frequency, 2.0 * math.pi * frequency * amplitude_rad * reach)
