"""The emulated object on vibrating palms, averaged over the signs of both slips instead of resolved in time. Pure.

At each instant both contacts slip forwards or backwards, s_i = ±1, with friction −μ s_i N_i along t_i. Slow motion is
the mean of the equations' solutions for the four pairs of signs, weighted by the shares of time that each pair lasts
(THEORY_DITHER §1, §2): slip i is forwards for p_i = 1/2 + asin(u_i/V_i)/π of the time, independently of the other one
or in a fixed phase to it. Forces are means. It holds for fast vibrations, sines on rigid mounts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from palmd.rig.curved_plant import CurvedPlant
from palmd.rig.plant import FrictionSurface, Hinge, PadPair, PalmFrame, Plant, _Rates
from palmd.rig.shaker import Shaking
from palmd.rig.shapes import Body
from palmd.system.vibration import Relation

Signs = tuple[float, ...]


def forward_share(slip: float, speed: float) -> float:
    """The share of time in which slip + speed·cos τ is positive; slip, speed in m/s."""
    return 0.5 + math.asin(min(max(slip / speed, -1.0), 1.0)) / math.pi


def shares(forward: Signs, relation: Relation) -> Iterator[tuple[Signs, float]]:
    """Pairs of slip signs along t1, t2 with the share of time of each, from both contacts' shares of forward slip.

    Palms in phase slip in opposite phase along t1 and t2, as t1 points outwards and t2 inwards.
    """
    if len(forward) == 1:
        yield (1.0,), forward[0]
        yield (-1.0,), 1.0 - forward[0]
        return
    p1, p2 = forward
    both = {"independent": p1 * p2, "antiphase": min(p1, p2), "in_phase": max(0.0, p1 + p2 - 1.0)}[relation]
    yield (1.0, 1.0), both
    yield (1.0, -1.0), p1 - both
    yield (-1.0, 1.0), p2 - both
    yield (-1.0, -1.0), 1.0 - p1 - p2 + both


class SignPairsPlant(Plant):
    """As `Plant`, on flat palms that vibrate as `shaking` says."""

    def __init__(self, body: Body, hinge: Hinge, surface: FrictionSurface, shaking: Shaking, **others: Any) -> None:
        """As `Plant` has it."""
        self._shaking = shaking
        self._slips: list[float] | None = None
        self._signs: list[float] = []
        super().__init__(body, hinge, surface, **others)

    def _compiled_step(self) -> None:
        """None is written for it."""

    def _solve(self, frame: PalmFrame, x: float, y: float, psi: float, vx: float, vy: float, w: float) -> _Rates:
        place = frame, x, y, psi, vx, vy, w
        self._slips = []
        free = super()._solve(*place)
        slips, self._slips = self._slips, None
        if not slips or self.surface.mu == 0.0:
            return free
        touching = [palm for palm, on in zip(self._shaking.palms, self.touching, strict=True) if on]
        forward = tuple(forward_share(u, palm.speed) for u, palm in zip(slips, touching, strict=True))
        mean = [0.0] * len(free)
        for signs, share in shares(forward, self._shaking.relation):
            if share:
                self._signs = list(reversed(signs))
                mean = [m + share * each for m, each in zip(mean, super()._solve(*place), strict=True)]
        ax, ay, al, f1, f2 = mean
        return ax, ay, al, f1, f2

    def _friction(self, slip: float) -> float:
        """Tangential over normal force of the contact that is asked for next, palm 1 before palm 2."""
        if self._slips is not None:
            self._slips.append(slip)
            return 0.0
        return self.surface.mu * self._signs.pop()


class CurvedSignPairsPlant(SignPairsPlant, CurvedPlant):
    """The same on arcs."""

    def __init__(
        self, body: Body, hinge: Hinge, surface: FrictionSurface, curvatures: PadPair, shaking: Shaking, **others: Any
    ) -> None:
        """As `CurvedPlant` has it."""
        self._shaking = shaking
        self._slips, self._signs = None, []
        CurvedPlant.__init__(self, body, hinge, surface, curvatures, **others)
