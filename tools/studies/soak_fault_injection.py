"""What is done to rig, bus and page during a soak: drawn at random from a seed. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from palmd.rig.fault_injection import INJECTABLE_FAULTS, PortName

GAP_S = (4.0, 16.0)
"""Between one doing and the next: half of them mischief, which needs time to be got over."""

UNHURRIED_S = 120.0
QUIET_S = 3.0  # at the beginning, and as much at the end


@dataclass(frozen=True, slots=True)
class SoakFault:
    """A mischief of the emulated rig."""

    what: ClassVar = "trick"
    name: str
    port: PortName | None
    strength: float
    for_s: float


@dataclass(frozen=True, slots=True)
class Say:
    """Somebody else's command; the operator takes up the work again after so long.

    `plan` stops the palms and loads the other of two plans: one is lively for ever, one explores.
    """

    what: ClassVar = "say"
    command: str
    for_s: float


@dataclass(frozen=True, slots=True)
class Visit:
    """Somebody comes for so long: a `listener`, one who listens and never takes anything (`deaf`), a `page`, or an
    `asker` who asks for the status and sends what is no command."""

    what: ClassVar = "visit"
    who: str
    for_s: float


Act = SoakFault | Say | Visit


@dataclass(frozen=True, slots=True)
class Doing:
    """What is done, and when (s from the beginning)."""

    t_s: float
    act: Act


_LASTS_S = (0.3, 3.0)
_SAYINGS = (("hold", (0.5, 4.0)), ("stop", (0.5, 4.0)), ("reset", (0.5, 1.0)), ("plan", (0.1, 1.0)))
_VISITS = (("listener", (0.2, 10.0)), ("deaf", (1.0, 25.0)), ("page", (1.0, 10.0)), ("asker", (0.1, 2.0)))


def draw(rng: np.random.Generator, seconds: float) -> list[Doing]:
    """Doings for so many seconds, in their order, closer in a short soak; all are over `QUIET_S` before the end."""
    haste = min(1.0, seconds / UNHURRIED_S)
    found: list[Doing] = []
    t = QUIET_S
    while t < seconds - QUIET_S:
        act = _act(rng)
        if t + act.for_s <= seconds - QUIET_S:
            found.append(Doing(t, act))
        t += haste * float(rng.uniform(*GAP_S))
    return found


def _act(rng: np.random.Generator) -> Act:
    kind = rng.random()
    if kind < 0.6:
        fault = list(INJECTABLE_FAULTS.values())[int(rng.integers(len(INJECTABLE_FAULTS)))]
        port = fault.ports[int(rng.integers(len(fault.ports)))] if fault.ports else None
        return SoakFault(
            fault.name, port, round(fault.strength * float(rng.uniform(0.3, 2.0)), 4), _uniform(rng, _LASTS_S)
        )
    if kind < 0.75:
        command, lasts = _SAYINGS[int(rng.integers(len(_SAYINGS)))]
        return Say(command, _uniform(rng, lasts))
    who, lasts = _VISITS[int(rng.integers(len(_VISITS)))]
    return Visit(who, _uniform(rng, lasts))


def _uniform(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return round(float(rng.uniform(*limits)), 3)
