"""How the emulated palms really vibrate along themselves: frequency, speed, phase, waveform, mount. Pure. SI units.

Palm i moves outwards, away from the hinge, with the speed w_i(t). t1 points outwards, t2 inwards: the body's slip along
t_i is u_1 − w_1 on palm 1 and u_2 + w_2 on palm 2, where u_i is its slip on palms that do not vibrate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from palmd.events import FloatArray
from palmd.system.mechanism import PALMS
from palmd.system.vibration import Relation, Vibration

INWARDS = (-1.0, 1.0)
"""Of each palm: the sign with which its outward speed adds to the slip along t_i."""
_RELATIONS: Sequence[Relation] = tuple(each for each in get_args(Relation) if each not in ("unknown", "none"))
_FREQUENCY_HZ = (200.0, 280.0)
_APART_HZ = (8.0, 25.0)  # of independent vibrations, which must differ by 5 Hz at least
_SPEED_SHARE = 0.1  # one sigma of what a shaker's speed is known by where nobody says
_TRANSMISSION_SD = 0.15
_SECOND, _THIRD = 0.005, 0.02  # one sigma of a real shaker's harmonics
_PALM_KG, _STIFF, _RATIO = (0.2, 0.8), (3.0, 6.0), (0.05, 0.2)


@dataclass(frozen=True, slots=True)
class Mount:
    """What a palm's pad rests on, across itself: its moving mass (kg), stiffness (N/m) and damping (N s/m)."""

    mass: float
    stiffness: float
    damping: float


RIGID = Mount(math.inf, math.inf, 0.0)
"""A palm that does not give way: normal forces follow friction at once (λ = 1)."""


@dataclass(frozen=True, slots=True)
class Shaker:
    """One palm's vibration: outward speed V (cos τ + second cos 2τ + third cos 3τ), τ = 2πft + phase."""

    frequency: float
    speed: float
    phase: float = 0.0
    second: float = 0.0
    third: float = 0.0
    mount: Mount = RIGID

    def outward_speed(self, t: float) -> float:
        """At t (s), in m/s."""
        tau = math.tau * self.frequency * t + self.phase
        return self.speed * (math.cos(tau) + self.second * math.cos(2.0 * tau) + self.third * math.cos(3.0 * tau))

    def outward_speeds(self, t: FloatArray) -> FloatArray:
        """The same at many times at once."""
        tau = math.tau * self.frequency * t + self.phase
        waves = np.cos(tau) + self.second * np.cos(2.0 * tau) + self.third * np.cos(3.0 * tau)
        return np.asarray(self.speed * waves, dtype=np.float64)

    def moved(self, t: float) -> float:
        """How far outwards the palm is at t (s), in m: the integral of its speed, with mean 0."""
        turn = math.tau * self.frequency
        tau = turn * t + self.phase
        waves = math.sin(tau) + self.second / 2.0 * math.sin(2.0 * tau) + self.third / 3.0 * math.sin(3.0 * tau)
        return self.speed / turn * waves


STILL = Shaker(frequency=1.0, speed=0.0)
"""A palm that does not vibrate."""


@dataclass(frozen=True, slots=True)
class Shaking:
    """Both palms' vibration, and the relation between them that it has."""

    relation: Relation
    palms: tuple[Shaker, ...]

    @property
    def period_s(self) -> float:
        """The mean of both palms'."""
        return sum(1.0 / palm.frequency for palm in self.palms) / len(self.palms)


def drawn_shaking(
    known: Vibration, rng: np.random.Generator, *, speed: float, pure: bool = False, body_mass: float = 0.1
) -> Shaking:
    """Vibrations as `known` describes them, the rest as shakers have it.

    speed: V (m/s) where nothing is known of it. pure: sines on rigid mounts. body_mass (kg): of what rests on the
    palms, to which a transmission refers.
    """
    relation = known.relation if known.relation != "unknown" else _RELATIONS[int(rng.integers(len(_RELATIONS)))]
    frequency = float(rng.uniform(*_FREQUENCY_HZ))
    if known.frequency is not None:
        frequency = known.frequency + (known.frequency_sd or 0.0) * float(rng.standard_normal())
    if known.speed is not None:
        sd = _SPEED_SHARE * known.speed if known.speed_sd is None else known.speed_sd
        speed = max(known.speed + sd * float(rng.standard_normal()), 0.1 * known.speed)
    apart = float(rng.uniform(*_APART_HZ)) if relation == "independent" else 0.0
    phase = float(rng.uniform(0.0, math.tau))
    between = {"independent": float(rng.uniform(0.0, math.tau)), "in_phase": 0.0, "antiphase": math.pi}[relation]
    shakers = (
        Shaker(frequency - 0.5 * apart, speed, phase),
        Shaker(frequency + 0.5 * apart, speed, phase + between),
    )
    if pure:
        return Shaking(relation, shakers)
    mount = _mount(known, frequency, body_mass, rng)
    distorted = (
        replace(each, second=_SECOND * float(a), third=_THIRD * float(b), mount=mount)
        for each, (a, b) in zip(shakers, rng.standard_normal((len(PALMS), 2)), strict=True)
    )
    return Shaking(relation, tuple(distorted))


def _mount(known: Vibration, frequency: float, body_mass: float, rng: np.random.Generator) -> Mount:
    """Stiff, its resonance far above the vibration; soft and as light as a given transmission asks for."""
    palm, ratio, stiff = (float(rng.uniform(*each)) for each in (_PALM_KG, _RATIO, _STIFF))
    if known.transmission is not None:
        sd = _TRANSMISSION_SD if known.transmission_sd is None else known.transmission_sd
        share = known.transmission + sd * float(rng.standard_normal())
        if share > 0.95:
            return RIGID
        palm, stiff = body_mass * max(share, 0.05) / (1.0 - max(share, 0.05)), 1.0 / stiff
    total = palm + body_mass
    stiffness = total * (math.tau * stiff * frequency) ** 2
    return Mount(palm, stiffness, 2.0 * ratio * math.sqrt(stiffness * total))
