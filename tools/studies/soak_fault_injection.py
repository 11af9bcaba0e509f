"""What is done to rig, bus and page during a soak: drawn at random from a seed. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from palmd.rig.fault_injection import ARM, PADS, PORTS, PortName

Ports = tuple[PortName, ...]
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
    strength: float | None
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


_TRICKS: tuple[tuple[str, Ports, tuple[float, float] | None, tuple[float, float]], ...] = (
    ("drop", PORTS, (0.01, 0.2), (0.5, 4.0)),
    ("garble", PORTS, (0.01, 0.2), (0.5, 4.0)),
    ("mute", PORTS, None, (0.05, 3.0)),
    ("unplug", PORTS, None, (0.3, 4.0)),
    ("late", PORTS, (0.02, 0.2), (0.5, 4.0)),
    ("burst", PORTS, (0.016, 0.06), (0.5, 4.0)),
    ("misbaud", PORTS, None, (0.3, 2.0)),
    ("touch", PADS, (0.2, 1.0), (0.5, 3.0)),
    ("break", ARM, None, (0.1, 0.2)),
    ("estop", ARM, None, (0.5, 3.0)),
    ("power_off", ARM, None, (0.5, 3.0)),
    ("manual", ARM, None, (0.5, 3.0)),
    ("block", ARM, None, (0.5, 3.0)),
    ("freeze", ARM, None, (0.5, 3.0)),
    ("jump", ARM, (0.01, 0.03), (0.5, 3.0)),
    ("saturate", PADS, (4.0, 16.0), (0.5, 3.0)),
    ("lift", (), None, (0.5, 3.0)),
    ("swap", (), None, (1.0, 1.5)),
)
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
        name, ports, strengths, lasts = _TRICKS[int(rng.integers(len(_TRICKS)))]
        port = ports[int(rng.integers(len(ports)))] if ports else None
        return SoakFault(name, port, None if strengths is None else _uniform(rng, strengths), _uniform(rng, lasts))
    if kind < 0.75:
        command, lasts = _SAYINGS[int(rng.integers(len(_SAYINGS)))]
        return Say(command, _uniform(rng, lasts))
    who, lasts = _VISITS[int(rng.integers(len(_VISITS)))]
    return Visit(who, _uniform(rng, lasts))


def _uniform(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return round(float(rng.uniform(*limits)), 3)
