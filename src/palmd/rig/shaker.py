"""The emulated palms' vibration along themselves: frequency, speed, phase, waveform and mount. Pure. SI units.

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

SLIP_SIGNS = (-1.0, 1.0)
"""For each palm, the sign with which its outward speed adds to the slip along t_i."""
_RELATIONS: Sequence[Relation] = tuple(each for each in get_args(Relation) if each not in ("unknown", "none"))
_FREQUENCY_HZ = (200.0, 280.0)
_SEPARATION_HZ = (8.0, 25.0)  # between independent vibrations, which must differ by at least 5 Hz
_SPEED_RELATIVE_SD = 0.1  # relative standard deviation of a shaker's speed where the configuration states none
_TRANSMISSION_SD = 0.15
_SECOND_SD, _THIRD_SD = 0.005, 0.02  # standard deviations of a real shaker's harmonics
_PALM_KG, _RESONANCE_RATIO, _DAMPING_RATIO = (0.2, 0.8), (3.0, 6.0), (0.05, 0.2)


@dataclass(frozen=True, slots=True)
class Mount:
    """A pad's mount across the palm: moving mass (kg), stiffness (N/m) and damping (N s/m)."""

    mass: float
    stiffness: float
    damping: float


RIGID = Mount(math.inf, math.inf, 0.0)
"""A palm with a rigid mount: normal forces follow friction immediately (λ = 1)."""


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
        """Outward speed (m/s) at t (s)."""
        tau = math.tau * self.frequency * t + self.phase
        return self.speed * (math.cos(tau) + self.second * math.cos(2.0 * tau) + self.third * math.cos(3.0 * tau))

    def outward_speeds(self, t: FloatArray) -> FloatArray:
        """Outward speeds (m/s) at many times (s)."""
        tau = math.tau * self.frequency * t + self.phase
        waves = np.cos(tau) + self.second * np.cos(2.0 * tau) + self.third * np.cos(3.0 * tau)
        return np.asarray(self.speed * waves, dtype=np.float64)

    def displacement(self, t: float) -> float:
        """Outward displacement (m) at t (s): the integral of the speed, with mean 0."""
        omega = math.tau * self.frequency
        tau = omega * t + self.phase
        waves = math.sin(tau) + self.second / 2.0 * math.sin(2.0 * tau) + self.third / 3.0 * math.sin(3.0 * tau)
        return self.speed / omega * waves


STILL = Shaker(frequency=1.0, speed=0.0)
"""A palm that does not vibrate."""


@dataclass(frozen=True, slots=True)
class Shaking:
    """Both palms' vibration and the relation between them."""

    relation: Relation
    palms: tuple[Shaker, ...]

    @property
    def period_s(self) -> float:
        """Mean of both palms' periods."""
        return sum(1.0 / palm.frequency for palm in self.palms) / len(self.palms)


def drawn_shaking(
    known: Vibration, rng: np.random.Generator, *, speed: float, pure: bool = False, body_mass: float = 0.1
) -> Shaking:
    """Draw the palms' vibration as `known` describes it; what is not described is drawn as typical of shakers.

    speed: V (m/s) where `known` does not state it. pure: sines on rigid mounts. body_mass: mass (kg) on the palms, to
    which a transmission refers.
    """
    relation = known.relation if known.relation != "unknown" else _RELATIONS[int(rng.integers(len(_RELATIONS)))]
    frequency = float(rng.uniform(*_FREQUENCY_HZ))
    if known.frequency is not None:
        frequency = known.frequency + (known.frequency_sd or 0.0) * float(rng.standard_normal())
    if known.speed is not None:
        sd = _SPEED_RELATIVE_SD * known.speed if known.speed_sd is None else known.speed_sd
        speed = max(known.speed + sd * float(rng.standard_normal()), 0.1 * known.speed)
    separation = float(rng.uniform(*_SEPARATION_HZ)) if relation == "independent" else 0.0
    phase = float(rng.uniform(0.0, math.tau))
    phase_difference = {"independent": float(rng.uniform(0.0, math.tau)), "in_phase": 0.0, "antiphase": math.pi}[
        relation
    ]
    shakers = (
        Shaker(frequency - 0.5 * separation, speed, phase),
        Shaker(frequency + 0.5 * separation, speed, phase + phase_difference),
    )
    if pure:
        return Shaking(relation, shakers)
    mount = _mount(known, frequency, body_mass, rng)
    distorted = (
        replace(each, second=_SECOND_SD * float(a), third=_THIRD_SD * float(b), mount=mount)
        for each, (a, b) in zip(shakers, rng.standard_normal((len(PALMS), 2)), strict=True)
    )
    return Shaking(relation, tuple(distorted))


def _mount(known: Vibration, frequency: float, body_mass: float, rng: np.random.Generator) -> Mount:
    """A stiff mount with its resonance far above the vibration, or the soft light mount of a known transmission."""
    palm, damping_ratio, resonance_ratio = (
        float(rng.uniform(*each)) for each in (_PALM_KG, _DAMPING_RATIO, _RESONANCE_RATIO)
    )
    if known.transmission is not None:
        sd = _TRANSMISSION_SD if known.transmission_sd is None else known.transmission_sd
        transmission = known.transmission + sd * float(rng.standard_normal())
        if transmission > 0.95:
            return RIGID
        palm, resonance_ratio = (
            body_mass * max(transmission, 0.05) / (1.0 - max(transmission, 0.05)),
            1.0 / resonance_ratio,
        )
    total_mass = palm + body_mass
    stiffness = total_mass * (math.tau * resonance_ratio * frequency) ** 2
    return Mount(palm, stiffness, 2.0 * damping_ratio * math.sqrt(stiffness * total_mass))
