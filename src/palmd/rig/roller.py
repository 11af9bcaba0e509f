"""A ball or cylinder that a hand places at the upper end of a gently sloping palm and releases, repeatedly. Pure."""

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

RESISTANCE = 0.003  # rolling resistance of steel on a pad's foil
_RADIUS_M, _MASS_KG = 0.010, 0.033  # a steel ball of 20 mm
_FINGER_N = 0.4
_BELOW_RIM_M = 3e-3
_PUSH_M_S = 0.02  # largest speed that the hand leaves on release, in either direction
_MAX_SLOPE = math.radians(35.0)
_AT_REST_RAD_S = 2e-3
_AWAY_S, _HELD_S, _LYING_S = (0.9, 1.5), (0.15, 0.35), (0.1, 0.4)

_Phase = Literal["away", "held", "rolling", "lying"]


class Roller:
    """Rolls without slipping while the palms are at rest; as soon as they move, the hand takes it away."""

    def __init__(self, kind: RollerKind, gravity: float, reach: tuple[float, ...], rng: np.random.Generator) -> None:
        """`gravity` in m/s² along −Y, `reach` the pads' lengths (m). The generator's state determines the motion."""
        self._inertia = 1.0 + KINDS[kind]
        self._gravity, self._reach, self._rng = gravity, reach, rng
        self._phase: _Phase = "away"
        self._t_phase = self._t_end = -math.inf
        self._pad = 0
        self._s = self._speed = 0.0
        self._presses: tuple[list[Press], list[Press]] = ([], [])

    def advance(self, t: float, palms: PalmMotion) -> None:
        """Advance to t (s) with the palms' motion at that time."""
        if sum(map(abs, palms.rates)) > _AT_REST_RAD_S:
            self._begin("away", t, _AWAY_S)
        elif self._phase == "rolling":
            self._roll(t, palms)
        elif t >= self._t_end:
            self._next_phase(t, palms)
        self._presses = self._pressing(palms)

    def presses(self, pad: int) -> list[Press]:
        """Presses on pad 0 or 1."""
        return self._presses[pad]

    def _next_phase(self, t: float, palms: PalmMotion) -> None:
        if self._phase == "held":
            self._begin("rolling", t, (math.inf, math.inf))
        elif self._phase == "lying" or not self._place(palms):
            self._begin("away", t, _AWAY_S)
        else:
            self._begin("held", t, _HELD_S)

    def _begin(self, phase: _Phase, t: float, duration_s: tuple[float, float]) -> None:
        self._phase, self._t_phase = phase, t
        self._t_end = t + (math.inf if math.isinf(duration_s[0]) else float(self._rng.uniform(*duration_s)))

    def _place(self, palms: PalmMotion) -> bool:
        """Place the roller on the palm with the gentler slope; returns False if that slope is unsuitable."""
        slopes = _slopes(palms)
        self._pad = int(slopes[1] < slopes[0])
        self._s = self._reach[self._pad] - _BELOW_RIM_M
        self._speed = float(self._rng.uniform(-_PUSH_M_S, _PUSH_M_S))
        return 0.0 < slopes[self._pad] < _MAX_SLOPE

    def _roll(self, t: float, palms: PalmMotion) -> None:
        """s̈ = −g·(sin α ∓ μ·cos α)/(1 + ρ²/R²) on the slope α; the resistance opposes the motion."""
        alpha = _slopes(palms)[self._pad]
        dt, self._t_phase = t - self._t_phase, t
        resistance = -math.copysign(RESISTANCE * math.cos(alpha), self._speed)
        acceleration = self._gravity * (resistance - math.sin(alpha)) / self._inertia
        self._s += self._speed * dt + 0.5 * acceleration * dt * dt
        self._speed += acceleration * dt
        if self._s > self._reach[self._pad]:
            self._begin("away", t, _AWAY_S)
        elif self._s <= _wedge_distance(palms):
            self._begin("lying", t, _LYING_S)

    def _pressing(self, palms: PalmMotion) -> tuple[list[Press], list[Press]]:
        if self._phase == "away":
            return [], []
        weight = _MASS_KG * self._gravity
        if self._phase == "lying":
            s, sine = _wedge_distance(palms), math.sin(palms.angles[OPENING])
            forces = (math.sin(sum(palms.angles)), math.sin(palms.angles[0]))
            first, second = ([Press(s, weight * force / sine)] for force in forces)
            return first, second
        finger = _FINGER_N if self._phase == "held" else 0.0
        press = [Press(self._s, weight * math.cos(_slopes(palms)[self._pad]) + finger)]
        return (press, []) if self._pad == 0 else ([], press)


def _slopes(palms: PalmMotion) -> tuple[float, float]:
    """Slope of each palm towards the hinge (rad)."""
    slope, opening = palms.angles
    return slope, math.pi - slope - opening


def _wedge_distance(palms: PalmMotion) -> float:
    """Distance (m) from the hinge at which the roller touches both palms."""
    return _RADIUS_M / math.tan(0.5 * palms.angles[OPENING])
