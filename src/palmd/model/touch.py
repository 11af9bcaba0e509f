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
from dataclasses import dataclass, replace

from palmd.model.contact import Contact, alongs, sinc
from palmd.model.symbolic import SX, ca
from palmd.system.mechanism import PALMS, SIDES, normal_directions

Outline = Callable[[SX, int], Contact]
"""What a palm of that number feels where the outward normal is that angle (rad)."""

BLIND, WARM = (2, 1, 1), (1,)
"""Steps of the search after each look at the outline: from s = 0, and from where the contacts were milliseconds ago."""
SAME_DEPTH = 3  # to which expressions are compared
FARTHEST_M = 1.0  # from the hinge, where the search may lead: no palm is longer
MOST_HALF = 1.5  # rad: half a turn beyond which the search takes it for that much
LEAST_SLACK = 0.05  # of 1 − κv: below it the object lies in the palm rather than on it


@dataclass(frozen=True, slots=True)
class _Read:
    """What a palm feels at the normal `theta` (rad), and how that changes with the normal."""

    theta: SX
    felt: Contact
    rates: tuple[SX, SX, SX]  # of r, d, v (m/rad)

    @classmethod
    def of(cls, outline: Outline, theta: SX, palm: int) -> _Read:
        felt = outline(theta, palm)
        v_rate = ca.jacobian(felt.v, theta) if felt.v_rate is None else felt.v_rate
        return cls(theta, felt, (-felt.d, felt.r - felt.v, v_rate))

    def past(self, angle: SX) -> Contact:
        """What it feels that far on from `theta` (rad)."""
        r, d, v = (each * angle for each in self.rates)
        return replace(self.felt, r=self.felt.r + r, d=self.felt.d + d, v=self.felt.v + v)


def _slack(curvature: SX, v: SX) -> SX:
    return ca.fmax(1 - curvature * v, LEAST_SLACK)


class Touch:
    """Finds the contacts of one kernel's expressions, each from where the last ones were.

    The outline is costly to read, and more so its derivatives. So it is read at few normals, which no derivative looks
    into, and is linear about each of them; the steps of the search are left out of derivatives too, but for one more
    from where they lead to, which has those of the implicit function exactly. So `thawed` has to put both in once all
    derivatives have been taken, of first order only.
    """

    def __init__(self, curvatures: Sequence[SX] = (), near: Sequence[SX] = ()) -> None:
        """`curvatures` of both palms (1/m); none, or zeros that are no symbols, make the palms flat.

        `near`: s1, s2 milliseconds ago (m). From there one look and one step do, to micrometres where the contacts
        move by less than a millimetre in between; derivatives by the pose are not exact then.
        """
        self._curvatures = [SX(each) for each in curvatures or (0, 0)]
        self.flat = all(each.is_zero() for each in self._curvatures)
        self._frozen: list[tuple[SX, SX]] = []
        self._last = list(near)  # s1, s2 found last
        self._once = bool(near)
        self._found: list[tuple[SX, tuple[Contact, Contact]]] = []  # for which angles

    def contacts(
        self, phi1: SX, phi2: SX, psi: SX, outline: Outline, bends: Sequence[SX] = (), standoffs: Sequence[SX] = ()
    ) -> tuple[Contact, Contact]:
        """Both contacts of an object turned by `psi`, its `outline` at any normal.

        `bends` add to the curvatures (1/m); the palms lie `standoffs` (m) above the hinge line, on the object's side.
        """
        if self.flat:
            one, two = map(outline, normal_directions((phi1, phi2), psi), PALMS)
            return one, two
        pose = ca.vertcat(phi1, phi2, psi)
        for known_pose, contacts in self._found:
            if ca.is_equal(known_pose, pose, SAME_DEPTH):
                return contacts
        curvatures = [kappa + more for kappa, more in zip(self._curvatures, bends or (SX(0), SX(0)), strict=True)]
        offs = standoffs or (SX(0), SX(0))

        def turns(s: Sequence[SX]) -> list[SX]:
            return [side * kappa * each for side, kappa, each in zip(SIDES, curvatures, s, strict=True)]

        def normals(s: Sequence[SX]) -> tuple[SX, ...]:
            one, two = turns(s)
            return normal_directions((phi1 + one, phi2 + two - one), psi)

        def read(s: Sequence[SX]) -> list[_Read]:
            return [_Read.of(outline, self._freeze(theta), palm) for theta, palm in zip(normals(s), PALMS, strict=True)]

        def at(s: Sequence[SX], known: Sequence[_Read]) -> tuple[Contact, Contact]:
            one, two = (
                replace(
                    each.past(theta - each.theta),
                    curvature=kappa,
                    turn=turn,
                    above=off - kappa / 2 * (place * sinc(turn / 2)) ** 2,
                )
                for each, theta, off, kappa, turn, place in zip(
                    known, normals(s), offs, curvatures, turns(s), s, strict=True
                )
            )
            return one, two

        def step(s: Sequence[SX], known: Sequence[_Read]) -> list[SX]:
            touching = at(s, known)
            return [
                each
                + (along - each * sinc(contact.turn / 2) * ca.cos(contact.turn / 2))
                / self._freeze(_slack(contact.curvature, contact.v))
                for each, along, contact in zip(s, alongs(phi2, *touching), touching, strict=True)
            ]

        def search(s: Sequence[SX], known: Sequence[_Read], begun: Sequence[SX]) -> list[SX]:
            """As `step`, cheaply: sine and cosine of half the turns by their series, good enough to go on from."""
            ways, above, felt = [], [], []
            for each, off, kappa, side, place, start in zip(known, offs, curvatures, SIDES, s, begun, strict=True):
                half = ca.fmin((kappa * place / 2) ** 2, MOST_HALF**2)
                chord = place * (1 - half / 6 * (1 - half / 20 * (1 - half / 42)))
                felt.append(each.past(side * kappa * (place - start)))
                ways.append(chord * (1 - half / 2 * (1 - half / 12 * (1 - half / 30))))
                above.append(felt[-1].r + off - kappa / 2 * chord**2)
            one, two = turns(s)
            cos, sin = ca.cos(phi2 + two - one), ca.sin(phi2 + two - one)
            along = (above[0] * cos + above[1]) / sin - felt[0].d, (above[1] * cos + above[0]) / sin + felt[1].d
            return [
                ca.fmin(ca.fmax(place + (to - way) / _slack(kappa, contact.v), -FARTHEST_M), FARTHEST_M)
                for place, to, way, kappa, contact in zip(s, along, ways, curvatures, felt, strict=True)
            ]

        s = self._last or [SX(0), SX(0)]
        for steps in WARM if self._last else BLIND:
            known, begun = read(s), s
            for _ in range(steps):
                s = search(s, known, begun)
        self._last = [self._freeze(each) for each in s]
        if self._once:
            contacts = at(self._last, known)
        else:
            known = read(self._last)
            contacts = at(step(self._last, known), known)
        self._found.append((pose, contacts))
        return self._found[-1][1]

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
