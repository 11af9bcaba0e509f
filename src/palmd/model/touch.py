"""Contacts of an object on palms that are arcs, as CasADi expressions (docs/theory/curved.md).

Palm i leaves the hinge in direction φ_i with signed curvature κ_i (1/m, > 0 concave, 0 flat): at arc length s its
tangent has turned by ± κ s. The contacts are given implicitly by the outline, evaluated at the tangents' normals. With
c the centre of mass from both tangents, the residual of palm i along its tangent is along_i − s sinc κs, and since
∂c/∂s = ±(1 − κv) t, Newton's method in both unknowns is

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
"""Contact of palm number `int` (1, 2) at an outward normal (rad)."""

COLD_STEPS, WARM_STEPS = 2, 1
"""Newton steps after each evaluation of the outline: after the first evaluation of a search without a starting point,
at the contacts of a circle; after the last, the only one if the contacts milliseconds ago are known."""
SAME_DEPTH = 3  # depth to which expressions are compared
FARTHEST_M = 1.0  # bound on |s|; no palm is longer
MOST_HALF = 1.5  # rad, bound on half a turn
MOST_SINE = 0.9  # bound on the sine of a turn at a circle's contact
MOST_CHANGE = 0.5  # rad, half a change of normal beyond which the second-order term is worthless
LEAST_CURVATURE_MARGIN = 0.05  # lower bound of 1 − κv; below it the object does not fit into the concave palm


@dataclass(frozen=True, slots=True)
class _OutlineSample:
    """Contact at the normal `theta` (rad) and its derivatives by the normal."""

    theta: SX
    contact: Contact
    rates: tuple[SX, SX, SX]  # of r, d, v (m/rad)

    @classmethod
    def of(cls, outline: Outline, theta: SX, palm: int) -> _OutlineSample:
        contact = outline(theta, palm)
        v_rate = ca.jacobian(contact.v, theta) if contact.v_rate is None else contact.v_rate
        return cls(theta, contact, (-contact.d, contact.r - contact.v, v_rate))

    def extrapolated(self, angle: SX) -> Contact:
        """Return the contact at `theta` + `angle` (rad): r and d to second order, v to first order."""
        (r, d, v), half = self.rates, ca.fmin(ca.fmax(0.5 * angle, -MOST_CHANGE), MOST_CHANGE)
        return replace(
            self.contact,
            r=self.contact.r + angle * (r + half * -d),
            d=self.contact.d + angle * (d + half * (r - v)),
            v=self.contact.v + angle * v,
        )


def _on_circle(phi2: SX, radius: SX, curvatures: Sequence[SX]) -> list[SX]:
    """Return s1, s2 for a circle of that radius (m), up to terms of fourth order in its turns.

    Its centre w has the same distance from both arcs, n·w − κ|w|²/2 = a − κa²/2: linear in w for given q = |w|², and a
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
    q = 2 * (x0**2 + y0**2) / ca.fmax(slope + root, LEAST_CURVATURE_MARGIN)
    x, y = x0 + q * x1, y0 + q * y1
    contacts = []
    for kappa, position in zip(curvatures, (x, x * cos + y * sin), strict=True):
        chord = position / _curvature_margin(kappa, radius)
        sine2 = ca.fmin((kappa * chord) ** 2, MOST_SINE**2)
        contacts.append(ca.fmin(ca.fmax(chord * (1 + sine2 * (1 / 6 + 3 / 40 * sine2)), -FARTHEST_M), FARTHEST_M))
    return contacts


def _sinc_and_cos(half: SX) -> tuple[SX, SX]:
    """Return sin x/x and cos x by their series, accurate to 10⁻⁹ up to 0.5 rad and 2·10⁻⁵ up to `MOST_HALF`."""
    square = ca.fmin(half**2, MOST_HALF**2)
    sinc, cos = SX(1), SX(1)
    for k in (8, 6, 4, 2):
        sinc, cos = 1 - square * sinc * (1 / (k * (k + 1))), 1 - square * cos * (1 / (k * (k - 1)))
    return sinc, cos


def _curvature_margin(curvature: SX, v: SX) -> SX:
    return ca.fmax(1 - curvature * v, LEAST_CURVATURE_MARGIN)


class Touch:
    """Contact search in one kernel's expressions; each search starts at the contacts of the previous one.

    The outline, and more so its derivatives, are costly to evaluate. So it is evaluated at few normals, held as symbols
    that derivatives treat as constants, and extrapolated from each. The search steps are constants for derivatives too,
    except for one last step, whose first derivatives are exactly those of the implicit function. `thawed` must
    substitute all these symbols once all derivatives, of first order only, have been taken.
    """

    def __init__(self, curvatures: Sequence[SX] = (), near: Sequence[SX] = ()) -> None:
        """`curvatures`: of both palms (1/m); none, or constant zeros, for flat palms.

        `near`: s1, s2 milliseconds ago (m). From there one evaluation and one step suffice, accurate to micrometres if
        the contacts moved by less than a millimetre; derivatives by the pose are then not exact.
        """
        self._curvatures = [SX(each) for each in curvatures or (0, 0)]
        self.flat = all(each.is_zero() for each in self._curvatures)
        self._frozen: list[tuple[SX, SX]] = []
        self._last = list(near)  # s1, s2 of the last search
        self._once = bool(near)
        self._known: list[tuple[SX, tuple[Contact, Contact]]] = []  # poses and their contacts

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
        """Return both contacts of an object at orientation `psi`.

        `outline`: its contact at any normal. `radius`: its mean radius (m). `bends` (1/m) add to the curvatures; the
        palms lie `standoffs` (m) above the hinge line, on the object's side.
        """
        if self.flat:
            one, two = map(outline, normal_directions((phi1, phi2), psi), PALMS)
            return one, two
        pose = ca.vertcat(phi1, phi2, psi)
        for known_pose, contacts in self._known:
            if ca.is_equal(known_pose, pose, SAME_DEPTH):
                return contacts
        curvatures = [kappa + more for kappa, more in zip(self._curvatures, bends or (SX(0), SX(0)), strict=True)]
        heights = standoffs or (SX(0), SX(0))

        def turns(s: Sequence[SX]) -> list[SX]:
            return [side * kappa * each for side, kappa, each in zip(SIDES, curvatures, s, strict=True)]

        def normals(s: Sequence[SX]) -> tuple[SX, ...]:
            one, two = turns(s)
            return normal_directions((phi1 + one, phi2 + two - one), psi)

        def sample(s: Sequence[SX]) -> list[_OutlineSample]:
            return [
                _OutlineSample.of(outline, self.freeze(theta), palm)
                for theta, palm in zip(normals(s), PALMS, strict=True)
            ]

        def at(s: Sequence[SX], samples: Sequence[_OutlineSample]) -> tuple[Contact, Contact]:
            one, two = (
                replace(
                    each.extrapolated(theta - each.theta),
                    curvature=kappa,
                    turn=turn,
                    above=height - 0.5 * kappa * (arc_length * _sinc_and_cos(0.5 * turn)[0]) ** 2,
                )
                for each, theta, height, kappa, turn, arc_length in zip(
                    samples, normals(s), heights, curvatures, turns(s), s, strict=True
                )
            )
            return one, two

        def step(s: Sequence[SX], samples: Sequence[_OutlineSample]) -> list[SX]:
            current, stepped = at(s, samples), []
            for arc_length, along, contact in zip(s, alongs(phi2, *current), current, strict=True):
                sinc, cos = _sinc_and_cos(0.5 * contact.turn)
                change = (along - arc_length * sinc * cos) / self.freeze(
                    _curvature_margin(contact.curvature, contact.v)
                )
                stepped.append(ca.fmin(ca.fmax(arc_length + change, -FARTHEST_M), FARTHEST_M))
            return stepped

        def search(s: list[SX], samples: Sequence[_OutlineSample], steps: int) -> list[SX]:
            for _ in range(steps):
                s = step(s, samples)
            return s

        s = self._last
        if not s:
            s = _on_circle(phi2, radius, curvatures)
            s = search(s, sample(s), COLD_STEPS)
        samples = sample(s)
        self._last = [self.freeze(each) for each in search(s, samples, WARM_STEPS)]
        contacts = at(self._last if self._once else step(self._last, samples), samples)
        self._known.append((pose, contacts))
        return self._known[-1][1]

    def freeze(self, value: SX) -> SX:
        """Return a symbol that derivatives treat as constant, until `thawed` substitutes the value for it."""
        symbol = SX.sym("frozen")
        self._frozen.append((symbol, value))
        return symbol

    def thawed(self, *outputs: SX) -> list[SX]:
        """Return a kernel's outputs with all searches substituted, as expressions of its inputs only."""
        thawed = list(outputs)
        for frozen, value in reversed(self._frozen):
            thawed = ca.substitute(thawed, [frozen], [value])
        return thawed
