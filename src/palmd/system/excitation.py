"""Which law of friction an excitation of the palms asks for, by frequency and speed (docs/theory/vibration.md). Pure.

Motion of the plan is slow: friction is dry, the object sticks and slips, and models follow it in steps. A vibration is
averaged where it is much faster than the object moves and strong enough that no contact sticks through a reversal.
What is between is neither, and must be resolved step by step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

PLAN_MOST_HZ = 20.0
"""Up to which a plan may shake the palms: that is motion."""
SLOW_HZ = 5.0
"""Bandwidth of what an object between palms does: it rocks at 1 to 5 Hz."""
FASTER = 10.0
"""By which factor a vibration must be faster than that to be averaged."""
STICKS = 1.9
"""2πfV over the acceleration that friction gives a contact, below which the contact sticks while slip reverses."""
FRICTION_SHARE = 2.4
"""That acceleration over μg: 1.3 on the average of ellipses between palms at rest, below this in 95 % of them."""
MOST_FRICTION = 0.3
"""Coefficient of friction that a vibration should be strong enough for: objects with more are rare."""
STEPS_A_PERIOD = 20
"""Of an excitation that is resolved."""
RESONANT = (0.5, 2.0)
"""Of a frequency over a resonance: between them normal forces answer friction by up to 2.6 times, or the wrong way."""


class Regime(StrEnum):
    """What a model must do with an excitation."""

    AVERAGED = "averaged"
    """Average over it: signs of slip are shared out in time."""
    STEPS = "resolved in substeps"
    """Resolve it: it is neither slow nor fast and strong."""
    DRY = "dry"
    """Follow it as motion: dry friction, which sticks."""


@dataclass(frozen=True, slots=True)
class Excitation:
    """A harmonic motion of the palms along themselves: frequency (Hz), amplitude of its speed (m/s)."""

    frequency: float
    speed: float

    @property
    def acceleration(self) -> float:
        """Its amplitude, 2πfV (m/s²)."""
        return 2.0 * math.pi * self.frequency * self.speed

    @property
    def longest_step_s(self) -> float:
        """Of a model that resolves it."""
        return 1.0 / (STEPS_A_PERIOD * self.frequency)


def friction_acceleration(mu: float, gravity: float) -> float:
    """By how much friction accelerates a contact at most, along the palm (m/s²), for a coefficient of friction."""
    return FRICTION_SHARE * mu * gravity


def sticks(excitation: Excitation, friction: float) -> bool:
    """Whether a contact sticks through it, against so much acceleration by friction (m/s²)."""
    return excitation.acceleration <= STICKS * friction


def regime(excitation: Excitation, friction: float, slow_hz: float = SLOW_HZ) -> Regime:
    """What a model must do with it; slow_hz: bandwidth of the object's own motion."""
    if excitation.frequency <= PLAN_MOST_HZ:
        return Regime.DRY
    fast = excitation.frequency >= FASTER * slow_hz
    return Regime.AVERAGED if fast and not sticks(excitation, friction) else Regime.STEPS


def least_speed(frequency: float, friction: float) -> float:
    """The amplitude of speed (m/s) from which a vibration of this frequency does not let a contact stick."""
    return STICKS * friction / (2.0 * math.pi * frequency)


def resonance_hz(stiffness: float, mass: float) -> float:
    """f_c of a mass (kg) on a contact or mount of so much stiffness (N/m)."""
    return math.sqrt(stiffness / mass) / (2.0 * math.pi)


def resonates(frequency: float, resonance: float) -> bool:
    """Whether a frequency is so near to a resonance that nothing is known of how normal forces answer."""
    return RESONANT[0] < frequency / resonance < RESONANT[1]


def swung(amplitude_rad: float, frequency: float, reach: float) -> Excitation:
    """What palms that turn to and fro do at a contact that is so far from the hinge (m), at most."""
    return Excitation(frequency, 2.0 * math.pi * frequency * amplitude_rad * reach)
