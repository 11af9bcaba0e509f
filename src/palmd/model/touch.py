"""Where an object touches palms that are arcs, as CasADi expressions (docs/theory/curved.md).

Palm i leaves the hinge in its direction φ_i and bends by its signed curvature κ_i (1/m, > 0 concave, 0 flat): at the
arc length s its tangent has turned by ± κ s. Where the object touches both is implicit in the outline, which is read
at the tangents' normals. With c the COM that both tangents give, palm i misses it along its tangent by
along_i − s sinc κs, and since ∂c/∂s = ±(1 − κv) t, Newton's method in both unknowns is

    s_i ← s_i + (along_i − s_i sinc κ_i s_i)/(1 − κ_i v_i),

which for flat palms is (3.13), (3.14) after one step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from palmd.model.contact import Contact, alongs, sinc
from palmd.model.symbolic import SX, ca
from palmd.system.mechanism import PALMS, SIDES, normal_directions

Outline = Callable[[SX, int], Contact]
"""What a palm of that number feels where the outward normal is that angle (rad)."""

BLIND_STEPS, WARM_STEPS = 6, 2
"""Of Newton's method from s = 0, and from where the contacts were a few milliseconds ago."""
FARTHEST_M = 1.0  # from the hinge, where the search may lead: no palm is longer
LEAST_SLACK = 0.05  # of 1 − κv: below it the object lies in the palm rather than on it


class Touch:
    """Finds the contacts of one kernel's expressions, each from where the last ones were.

    The steps of the search are left out of derivatives, but for one more from where they lead to, which has those of
    the implicit function exactly. So `thawed` has to put the search in once all derivatives have been taken.
    """

    def __init__(self, curvatures: Sequence[SX] = ()) -> None:
        """`curvatures` of both palms (1/m); none, or zeros that are no symbols, make the palms flat."""
        self._curvatures = [SX(each) for each in curvatures or (0, 0)]
        self.flat = all(each.is_zero() for each in self._curvatures)
        self._frozen: list[tuple[SX, SX]] = []
        self._last: list[SX] = []  # s1, s2 found last

    def contacts(
        self, phi1: SX, phi2: SX, psi: SX, outline: Outline, bends: Sequence[SX] = ()
    ) -> tuple[Contact, Contact]:
        """Both contacts of an object turned by `psi`, its `outline` at any normal; `bends` add to the curvatures."""
        if self.flat:
            one, two = map(outline, normal_directions((phi1, phi2), psi), PALMS)
            return one, two
        curvatures = [kappa + more for kappa, more in zip(self._curvatures, bends or (SX(0), SX(0)), strict=True)]

        def at(s: Sequence[SX]) -> tuple[Contact, Contact]:
            turns = [side * kappa * each for side, kappa, each in zip(SIDES, curvatures, s, strict=True)]
            normals = normal_directions((phi1 + turns[0], phi2 + turns[1] - turns[0]), psi)
            one, two = (
                replace(felt, curvature=kappa, turn=turn, above=-kappa / 2 * (each * sinc(turn / 2)) ** 2)
                for felt, kappa, turn, each in zip(map(outline, normals, PALMS), curvatures, turns, s, strict=True)
            )
            return one, two

        def step(s: Sequence[SX], hold: Callable[[SX], SX] = lambda x: x) -> list[SX]:
            touching = at(s)
            return [
                each
                + (along - each * sinc(contact.turn)) / hold(ca.fmax(1 - contact.curvature * contact.v, LEAST_SLACK))
                for each, along, contact in zip(s, alongs(phi2, *touching), touching, strict=True)
            ]

        s = self._last or [SX(0), SX(0)]
        for _ in range(WARM_STEPS if self._last else BLIND_STEPS):
            s = [ca.fmin(ca.fmax(each, -FARTHEST_M), FARTHEST_M) for each in step(s)]
        self._last = [self._freeze(each) for each in s]
        return at(step(self._last, self._freeze))

    def _freeze(self, value: SX) -> SX:
        symbol = SX.sym("frozen")
        self._frozen.append((symbol, value))
        return symbol

    def thawed(self, *outputs: SX) -> list[SX]:
        """The outputs of a kernel with all searches put in: expressions of its inputs alone."""
        thawed = list(outputs)
        for frozen, value in reversed(self._frozen):
            thawed = ca.substitute(thawed, [frozen], [value])
        return thawed
