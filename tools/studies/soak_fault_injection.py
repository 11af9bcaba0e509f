"""The random schedule of a soak: injected faults, operator commands, visitors. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palmd.rig.fault_injection import INJECTABLE_FAULTS
from tools.studies.study_processes import InjectedFault

GAP_S = (4.0, 16.0)
"""Range of time (s) between acts; more than half of them are faults, which need time for recovery."""

UNHURRIED_S = 120.0  # shorter soaks have proportionally shorter gaps
QUIET_S = 3.0  # without acts at the beginning and at the end


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """A command by another operator; the simulated operator resumes after `for_s` (s).

    `plan` stops the palms and loads the other of two plans: a lively one without end, and an exploration.
    """

    command: str
    for_s: float


@dataclass(frozen=True, slots=True)
class Visitor:
    """A client that connects for `for_s` (s).

    `listener`: a subscriber; `deaf`: a subscriber that never reads; `page`: a live page; `asker`: a client that
    requests the status and sends malformed commands.
    """

    who: str
    for_s: float


Act = InjectedFault | OperatorCommand | Visitor
WHAT = {InjectedFault: "trick", OperatorCommand: "say", Visitor: "visit"}
"""Names of the acts in a soak's file."""


@dataclass(frozen=True, slots=True)
class ScheduledAct:
    """An act and its time (s from the beginning)."""

    t_s: float
    act: Act


_FAULT_S = (0.3, 3.0)
_COMMANDS = (("hold", (0.5, 4.0)), ("stop", (0.5, 4.0)), ("reset", (0.5, 1.0)), ("plan", (0.1, 1.0)))
_VISITS = (("listener", (0.2, 10.0)), ("deaf", (1.0, 25.0)), ("page", (1.0, 10.0)), ("asker", (0.1, 2.0)))


def draw(rng: np.random.Generator, seconds: float) -> list[ScheduledAct]:
    """Acts for so many seconds in order of time, denser in a short soak; all end `QUIET_S` before the end."""
    gap_scale = min(1.0, seconds / UNHURRIED_S)
    found: list[ScheduledAct] = []
    t = QUIET_S
    while t < seconds - QUIET_S:
        act = _act(rng)
        if t + act.for_s <= seconds - QUIET_S:
            found.append(ScheduledAct(t, act))
        t += gap_scale * float(rng.uniform(*GAP_S))
    return found


def _act(rng: np.random.Generator) -> Act:
    kind = rng.random()
    if kind < 0.6:
        fault = list(INJECTABLE_FAULTS.values())[int(rng.integers(len(INJECTABLE_FAULTS)))]
        port = fault.ports[int(rng.integers(len(fault.ports)))] if fault.ports else None
        return InjectedFault(
            fault.name, port, round(fault.strength * float(rng.uniform(0.3, 2.0)), 4), _uniform(rng, _FAULT_S)
        )
    if kind < 0.75:
        command, duration_s = _COMMANDS[int(rng.integers(len(_COMMANDS)))]
        return OperatorCommand(command, _uniform(rng, duration_s))
    who, duration_s = _VISITS[int(rng.integers(len(_VISITS)))]
    return Visitor(who, _uniform(rng, duration_s))


def _uniform(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return round(float(rng.uniform(*limits)), 3)
