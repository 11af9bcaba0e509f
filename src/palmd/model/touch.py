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

from palmd.model.contact import Contact, alongs
from palmd.model.symbolic import SX, ca
from palmd.system.mechanism import PALMS, SIDES, normal_directions

Outline = Callable[[SX, int], Contact]
"""What a palm of that number feels where the outward normal is that angle (rad)."""

BLIND, WARM = 2, 1
"""Steps of the search after a look at the outline: after the one more that a search from nowhere has, at a circle's
contacts; after the last, which alone serves where the contacts were milliseconds ago."""
SAME_DEPTH = 3  # to which expressions are compared
FARTHEST_M = 1.0  # from the hinge, where the search may lead: no palm is longer
MOST_HALF = 1.5  # rad: half a turn beyond which it is taken for that much
MOST_SINE = 0.9  # of a turn, beyond which a circle's contact is taken for that far
MOST_CHANGE = 0.5  # rad: half a change of normal beyond which the second order is worth nothing
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
        """What it feels that far on from `theta` (rad): r and d to second order, as v tells how both bend."""
        (r, d, v), half = self.rates, ca.fmin(ca.fmax(0.5 * angle, -MOST_CHANGE), MOST_CHANGE)
        return replace(
            self.felt,
            r=self.felt.r + angle * (r + half * -d),
            d=self.felt.d + angle * (d + half * (r - v)),
            v=self.felt.v + angle * v,
        )


def _on_circle(phi2: SX, radius: SX, curvatures: Sequence[SX]) -> list[SX]:
    """s1, s2 of a circle of that radius (m), but for the fourth order of its turns.

    Its centre w is as far from both arcs, n·w − κ|w|²/2 = a − κa²/2: linear in w where q = |w|² is known, and a
    quadratic equation in q.
    """
    sin, cos = ca.sin(phi2), ca.cos(phi2)
    fixed = [radius - 0.5 * kappa * radius**2 for kappa in curvatures]
    by_q = [0.5 * kappa for kappa in curvatures]

    def centre(along: Sequence[SX]) -> tuple[SX, SX]:
        return (along[1] + along[0] * cos) / sin, along[0]

    (x0, y0), (x1, y1) = centre(fixed), centre(by_q)
    slope = 1 - 2 * (x0 * x1 + y0 * y1)
    root = ca.sqrt(ca.fmax(slope**2 - 4 * (x0**2 + y0**2) * (x1**2 + y1**2), 0))
    q = 2 * (x0**2 + y0**2) / ca.fmax(slope + root, LEAST_SLACK)
    x, y = x0 + q * x1, y0 + q * y1
    found = []
    for kappa, way in zip(curvatures, (x, x * cos + y * sin), strict=True):
        chord = way / _slack(kappa, radius)
        sine = ca.fmin((kappa * chord) ** 2, MOST_SINE**2)
        found.append(ca.fmin(ca.fmax(chord * (1 + sine * (1 / 6 + 3 / 40 * sine)), -FARTHEST_M), FARTHEST_M))
    return found


def _sinc_and_cos(half: SX) -> tuple[SX, SX]:
    """sin x/x and cos x by their series, to 10⁻⁹ up to 0.5 rad and 2·10⁻⁵ up to `MOST_HALF`."""
    square = ca.fmin(half**2, MOST_HALF**2)
    sinc, cos = SX(1), SX(1)
    for k in (8, 6, 4, 2):
        sinc, cos = 1 - square * sinc * (1 / (k * (k + 1))), 1 - square * cos * (1 / (k * (k - 1)))
    return sinc, cos


def _slack(curvature: SX, v: SX) -> SX:
    return ca.fmax(1 - curvature * v, LEAST_SLACK)


class Touch:
    """Finds the contacts of one kernel's expressions, each from where the last ones were.

    The outline is costly to read, and more so its derivatives. So it is read at few normals, which no derivative looks
    into, and goes on from each by its derivatives; the steps of the search are left out of derivatives too, but for one
    more from where they lead to, which has those of the implicit function exactly. So `thawed` has to put both in once
    all derivatives have been taken, of first order only.
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
        self,
        phi1: SX,
        phi2: SX,
        psi: SX,
        outline: Outline,
        radius: SX,
        bends: Sequence[SX] = (),
        standoffs: Sequence[SX] = (),
    ) -> tuple[Contact, Contact]:
        """Both contacts of an object turned by `psi`, its `outline` at any normal, of that mean `radius` (m).

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
                    above=off - 0.5 * kappa * (place * _sinc_and_cos(0.5 * turn)[0]) ** 2,
                )
                for each, theta, off, kappa, turn, place in zip(
                    known, normals(s), offs, curvatures, turns(s), s, strict=True
                )
            )
            return one, two

        def step(s: Sequence[SX], known: Sequence[_Read]) -> list[SX]:
            touching, found = at(s, known), []
            for place, along, contact in zip(s, alongs(phi2, *touching), touching, strict=True):
                sinc, cos = _sinc_and_cos(0.5 * contact.turn)
                by = (along - place * sinc * cos) / self._freeze(_slack(contact.curvature, contact.v))
                found.append(ca.fmin(ca.fmax(place + by, -FARTHEST_M), FARTHEST_M))
            return found

        def search(s: list[SX], known: Sequence[_Read], steps: int) -> list[SX]:
            for _ in range(steps):
                s = step(s, known)
            return s

        s = self._last
        if not s:
            s = _on_circle(phi2, radius, curvatures)
            s = search(s, read(s), BLIND)
        known = read(s)
        self._last = [self._freeze(each) for each in search(s, known, WARM)]
        contacts = at(self._last if self._once else step(self._last, known), known)
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
