"""The emulated object on vibrating palms, averaged over the signs of both slips instead of resolved in time. Pure.

At each instant both contacts slip forwards or backwards, s_i = ±1, with friction −μ s_i N_i along t_i. Slow motion is
the mean of the equations' solutions for the four pairs of signs, weighted by the share of time of each pair
(docs/theory/vibration.md): slip i is forward for p_i = 1/2 + asin(u_i/V_i)/π of the time, independently of the other or
in a fixed phase relation. Forces are means. Valid for fast vibrations, sines on rigid mounts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

from palmd.rig.curved_plant import CurvedPlant
from palmd.rig.plant import BodyState, FrictionSurface, Hinge, PalmFrame, Plant, _Rates
from palmd.rig.shaker import Shaking
from palmd.rig.shapes import Body
from palmd.system.vibration import Relation

Signs = tuple[float, ...]
_RIPPLE_STEPS = 2


def forward_share(slip: float, speed: float, ripples: Sequence[float] = ()) -> float:
    """The share of time in which slip + speed·cos τ is positive, all in m/s.

    ripples: amplitudes by which the slip itself alternates (±).
    """
    shares = [
        0.5 + math.asin(min(max((slip + sum(each)) / speed, -1.0), 1.0)) / math.pi
        for each in product(*((ripple, -ripple) for ripple in ripples))
    ]
    return sum(shares) / len(shares)


def shares(forward: Sequence[float], relation: Relation) -> Iterator[tuple[Signs, float]]:
    """Pairs of slip signs along t1, t2 with the share of time of each, from both contacts' shares of forward slip.

    Palms in phase slip in opposite phase along t1 and t2, because t1 points outwards and t2 inwards.
    """
    if len(forward) == 1:
        yield (1.0,), forward[0]
        yield (-1.0,), 1.0 - forward[0]
        return
    p1, p2 = forward
    both_forward = {"independent": p1 * p2, "antiphase": min(p1, p2), "in_phase": max(0.0, p1 + p2 - 1.0)}[relation]
    yield (1.0, 1.0), both_forward
    yield (1.0, -1.0), p1 - both_forward
    yield (-1.0, 1.0), p2 - both_forward
    yield (-1.0, -1.0), 1.0 - p1 - p2 + both_forward


class SignPairsPlant(Plant):
    """As `Plant`, on flat palms that vibrate as `shaking` describes."""

    def __init__(self, body: Body, hinge: Hinge, surface: FrictionSurface, shaking: Shaking, **others: Any) -> None:
        self._shaking = shaking
        self._slips: list[float] | None = None
        self._signs: list[float] = []
        super().__init__(body, hinge, surface, **others)

    def _solve(self, frame: PalmFrame, q: BodyState) -> _Rates:
        self._slips = []
        frictionless = super()._solve(frame, q)
        slips, self._slips = self._slips, None
        if not slips or self.surface.mu == 0.0:
            return frictionless
        on = [i for i, touching in enumerate(self.touching) if touching]
        solved: dict[Signs, _Rates] = {}
        for signs in product((1.0, -1.0), repeat=len(slips)):
            self._signs = list(reversed(signs))
            solved[signs] = super()._solve(frame, q)
        speeds = [self._shaking.palms[i].speed for i in on]
        forward = [forward_share(u, speed) for u, speed in zip(slips, speeds, strict=True)]
        for _ in range(_RIPPLE_STEPS):
            ripples = self._ripples(frame, q.psi, on, solved, forward)
            forward = [forward_share(*each) for each in zip(slips, speeds, ripples, strict=True)]
        mean = [0.0] * len(frictionless)
        for signs, share in shares(forward, self._shaking.relation):
            mean = [m + share * each for m, each in zip(mean, solved[signs], strict=True)]
        ax, ay, al, f1, f2 = mean
        return ax, ay, al, f1, f2

    def _ripples(
        self, frame: PalmFrame, psi: float, on: list[int], solved: Mapping[Signs, _Rates], forward: Sequence[float]
    ) -> list[list[float]]:
        """For each contact's slip, its amplitudes (m/s) due to alternating friction, at the contact's own reversals.

        An alternating acceleration makes a triangle wave. A contact's own wave is at its tip where the contact
        reverses, that of an independent palm anywhere (1/√3 of the amplitude, RMS). Palms of one frequency reverse at
        about the same time.
        """
        relation = self._shaking.relation
        tangents = [self._tangent(i, frame, psi) for i in on]

        def slip_rate_jump(n: int, before: Signs, after: Signs) -> float:
            tx, ty, h = tangents[n]
            dx, dy, turn = (a - b for a, b in zip(solved[after][:3], solved[before][:3], strict=True))
            return tx * dx + ty * dy + h * turn

        def triangle(by: int, rate: float) -> float:
            return abs(rate) * forward[by] * (1.0 - forward[by]) / (2.0 * self._shaking.palms[on[by]].frequency)

        if len(on) == 1 or relation != "independent":
            first: Signs = (1.0, -1.0) if relation == "in_phase" and len(on) == 2 else (1.0,) * len(on)
            last = tuple(-sign for sign in first)
            return [[triangle(n, slip_rate_jump(n, last, first))] for n in range(len(on))]

        def jump_at_reversal(n: int, by: int) -> float:
            """The jump where `by` reverses, averaged over the other contact's direction of slip."""
            return sum(
                share * slip_rate_jump(n, *((before, after) if by == 0 else (before[::-1], after[::-1])))
                for share, before, after in (
                    (forward[1 - by], (-1.0, 1.0), (1.0, 1.0)),
                    (1.0 - forward[1 - by], (-1.0, -1.0), (1.0, -1.0)),
                )
            )

        return [
            [triangle(n, jump_at_reversal(n, n)), triangle(1 - n, jump_at_reversal(n, 1 - n)) / math.sqrt(3.0)]
            for n in (0, 1)
        ]

    def _tangent(self, palm: int, frame: PalmFrame, psi: float) -> tuple[float, float, float]:
        """t at the contact, and the lever arm of a force along it."""
        line = frame.palms[palm]
        return line.tx, line.ty, self.body.support.at(line.out - psi)[0]

    def _friction(self, slip: float) -> float:
        """Tangential over normal force; called for palm 1 before palm 2."""
        if self._slips is not None:
            self._slips.append(slip)
            return 0.0
        return self.surface.mu * self._signs.pop()


class CurvedSignPairsPlant(SignPairsPlant, CurvedPlant):
    """As `SignPairsPlant`, on arcs of `curvatures`, see `CurvedPlant`."""

    def _tangent(self, palm: int, frame: PalmFrame, psi: float) -> tuple[float, float, float]:
        del frame
        theta = self._theta[palm]
        return -math.sin(theta + psi), math.cos(theta + psi), self.body.support.at(theta)[0]
