"""A ball or cylinder that a hand sets on the upper end of a gently sloping palm and lets go, again and again. Pure."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from palmd.events import PalmMotion
from palmd.rig.pads import Press
from palmd.system.mechanism import OPENING

RollerKind = Literal["ball", "cylinder"]
KINDS: dict[RollerKind, float] = {"ball": 2.0 / 5.0, "cylinder": 1.0 / 2.0}
"""Moment of inertia over that of a hoop, (ρ/R)²."""

RESISTANCE = 0.003  # rolling, of steel on a pad's foil
_RADIUS_M, _MASS_KG = 0.010, 0.033  # a steel ball of 20 mm
_FINGER_N = 0.4
_BELOW_RIM_M = 3e-3
_PUSH_M_S = 0.02  # what the hand gives it on parting, to either side
_STEEPEST = math.radians(35.0)
_RESTING_RAD_S = 2e-3
_AWAY_S, _HELD_S, _LYING_S = (0.9, 1.5), (0.15, 0.35), (0.1, 0.4)

_Phase = Literal["away", "held", "rolling", "lying"]


class Roller:
    """Rolls without slipping as long as the palms stand still; as soon as they move, the hand has it."""

    def __init__(self, kind: RollerKind, gravity: float, reach: tuple[float, ...], rng: np.random.Generator) -> None:
        """`gravity` in m/s² along −Y, `reach` the pads' lengths (m); the same generator, the same hand."""
        self._inertia = 1.0 + KINDS[kind]
        self._gravity, self._reach, self._rng = gravity, reach, rng
        self._phase: _Phase = "away"
        self._t_phase = self._t_end = -math.inf
        self._pad = 0
        self._s = self._push = 0.0
        self._presses: tuple[list[Press], list[Press]] = ([], [])

    def advance(self, t: float, palms: PalmMotion) -> None:
        """Live on to t (s) with the palms as they are then."""
        if sum(map(abs, palms.rates)) > _RESTING_RAD_S:
            self._begin("away", t, _AWAY_S)
        elif self._phase == "rolling":
            self._roll(t, palms)
        elif t >= self._t_end:
            self._go_on(t, palms)
        self._presses = self._pressing(palms)

    def presses(self, pad: int) -> list[Press]:
        """What presses on pad 0 or 1."""
        return self._presses[pad]

    def _go_on(self, t: float, palms: PalmMotion) -> None:
        if self._phase == "held":
            self._begin("rolling", t, (math.inf, math.inf))
        elif self._phase == "lying" or not self._lay(palms):
            self._begin("away", t, _AWAY_S)
        else:
            self._begin("held", t, _HELD_S)

    def _begin(self, phase: _Phase, t: float, lasting_s: tuple[float, float]) -> None:
        self._phase, self._t_phase = phase, t
        self._t_end = t + (math.inf if math.isinf(lasting_s[0]) else float(self._rng.uniform(*lasting_s)))

    def _lay(self, palms: PalmMotion) -> bool:
        """Lay it on the palm that slopes more gently, if there is one."""
        slopes = _slopes(palms)
        self._pad = int(slopes[1] < slopes[0])
        self._s = self._reach[self._pad] - _BELOW_RIM_M
        self._push = float(self._rng.uniform(-_PUSH_M_S, _PUSH_M_S))
        return 0.0 < slopes[self._pad] < _STEEPEST

    def _roll(self, t: float, palms: PalmMotion) -> None:
        """s̈ = −g·(sin α ∓ μ·cos α)/(1 + ρ²/R²) on the slope α, resistance against the motion."""
        alpha = _slopes(palms)[self._pad]
        dt, self._t_phase = t - self._t_phase, t
        resistance = -math.copysign(RESISTANCE * math.cos(alpha), self._push)
        acceleration = self._gravity * (resistance - math.sin(alpha)) / self._inertia
        self._s += self._push * dt + 0.5 * acceleration * dt * dt
        self._push += acceleration * dt
        if self._s > self._reach[self._pad]:
            self._begin("away", t, _AWAY_S)
        elif self._s <= _wedge(palms):
            self._begin("lying", t, _LYING_S)

    def _pressing(self, palms: PalmMotion) -> tuple[list[Press], list[Press]]:
        if self._phase == "away":
            return [], []
        weight = _MASS_KG * self._gravity
        if self._phase == "lying":
            s, sine = _wedge(palms), math.sin(palms.angles[OPENING])
            forces = (math.sin(sum(palms.angles)), math.sin(palms.angles[0]))
            first, second = ([Press(s, weight * force / sine)] for force in forces)
            return first, second
        finger = _FINGER_N if self._phase == "held" else 0.0
        press = [Press(self._s, weight * math.cos(_slopes(palms)[self._pad]) + finger)]
        return (press, []) if self._pad == 0 else ([], press)


def _slopes(palms: PalmMotion) -> tuple[float, float]:
    """How steeply each palm falls towards the hinge (rad)."""
    first, opening = palms.angles
    return first, math.pi - first - opening


def _wedge(palms: PalmMotion) -> float:
    """How far from the hinge it touches both palms (m)."""
    return _RADIUS_M / math.tan(0.5 * palms.angles[OPENING])
