"""The emulated object between two moving palms: Newton–Euler in the world with constraint forces. Pure.

The formulation differs from the observer's model on purpose: the state is the body's position and velocity in the world
(x, y, ψ and their rates), the palms are moving lines through the hinge, and each contact is a unilateral constraint on
the gap

    γ(c, ψ, t) = n·(c − O) − h(θ),   θ = angle(−n) − ψ,

whose second derivative, set to zero, gives the normal force. Friction opposes the slip of the body's material on the
palm; on a vibrated palm it grows smoothly through zero slip. A palm whose surface is bowed or lies off the hinge line
is represented by the tangent at the point nearest to the body: the gap is stationary in the point's position.
Neglected are the square of the tangent's slope, and κṡ² in γ̈, for a bow of 0.1 mm 3e-3 m/s² at 0.1 m/s. World frame:
gravity along −Y, SI units; forces are per unit mass (m/s²) internally and in newtons in results.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypedDict, get_args

import numpy as np

from palmd.events import PalmMotion
from palmd.rig.imperfections import PERFECT, Imperfections
from palmd.rig.shapes import Body, Kind
from palmd.system.description import HingeMode

PadPair = tuple[float, ...]
FrictionLaw = Literal["averaged", "coulomb", "sign_pairs", "resolved"]
Physics = Literal["palmd", "mujoco"]
PHYSICS: tuple[Physics, ...] = get_args(Physics)

PAD_LENGTH = 0.0555  # m, from the hinge outwards
_DRIFT_RATE = 80.0  # 1/s: numerical drift of a closed gap is corrected at this rate, critically damped
_SOFT_IMPACT = 0.02  # m/s: a slower impact closes both contacts, to avoid endless chatter
_SEPARATION_SPEED = 1e-9  # m/s: a contact that separates faster after an impact is open
_PLACEMENT_ROUNDS = 4  # to match tangent planes and contacts of bowed palms; each reduces the error a hundredfold
_MIN_STEP_S, _MIN_RATE = 2e-6, 0.1  # s: of a step; rad/s: slower rates do not lengthen it
_LEVEL_TOLERANCE = 1e-9  # m: a COM whose height varies by no more is in equilibrium at any angle
_FALLEN_DISTANCE = 0.25  # m from the hinge: an object this far has fallen off


@dataclass(frozen=True, slots=True)
class Hinge:
    """Where the palms meet: `fixed` at `base`, or on an arc of palm1_length (m) around `base` (world, m)."""

    mode: HingeMode = "arc"
    palm1_length: float = 0.12
    base: tuple[float, float] = (0.12, 0.0)


@dataclass(frozen=True, slots=True)
class FrictionSurface:
    """Friction of the contacts: mu (–), dither speed u_d (m/s), damping c (m²/s, per unit mass).

    static: coefficient (–) of a sticking contact without dither, if larger than mu.
    """

    mu: float = 0.0
    dither: float = 0.01
    damping: float = 0.0
    static: float = 0.0


@dataclass(frozen=True, slots=True)
class PlantOptions:
    """Deviations of the emulated rig from the laws that the observer assumes; none by default.

    friction_law: None for the law that the rig's vibration requires, see `rig.friction`. hinge_travels: False fixes the
    hinge of an arc rig. lag_s: the palms move this much later than planned. physics: the engine that moves the object;
    MuJoCo has its own law of friction.
    """

    friction_law: FrictionLaw | None = None
    hinge_travels: bool = True
    lag_s: float = 0.0
    physics: Physics = "palmd"


@dataclass(frozen=True, slots=True)
class PlantContact:
    """One palm's contact: s (m) from the hinge, force (N), and whether the body touches."""

    touching: bool
    s: float
    force: float


@dataclass(slots=True)
class BodyState:
    """Position and velocity of the COM (world, m, m/s), and the body's angle and rate (rad, rad/s)."""

    x: float
    y: float
    psi: float
    vx: float = 0.0
    vy: float = 0.0
    omega0: float = 0.0


AS_ASSUMED = PlantOptions()
"""A plant as the observer assumes it."""


class PalmLine(NamedTuple):
    """One palm at one instant; SI, world.

    Tangent t, outwards on palm 1 and inwards on palm 2, so that (−ty, tx) is the normal on the object's side. out:
    direction of the body's outward normal at the contact. turn, alpha: rate and acceleration of the direction. above:
    height of the palm's plane over the hinge, on the object's side.
    """

    tx: float
    ty: float
    out: float
    turn: float
    alpha: float
    above: float


class PalmFrame(NamedTuple):
    """What the equations need at one instant: both palms, and the hinge's position, velocity and acceleration."""

    palms: tuple[PalmLine, PalmLine]
    ox: float
    oy: float
    vox: float
    voy: float
    aox: float
    aoy: float


class ContactMotion(NamedTuple):
    """A contact: the palm's tangent t, h and h′, and the motion of gap and slip without contact forces.

    gap_acceleration: γ̈, slip_rate: derivative of the slip (m/s²), both with drift correction; slip: velocity of the
    body's material along t relative to the palm's (m/s).
    """

    tx: float
    ty: float
    h: float
    slope: float
    gap_acceleration: float
    slip_rate: float
    slip: float


class UnitForce(NamedTuple):
    """Force and torque on the body of a unit normal force, with the friction proportional to it."""

    fx: float
    fy: float
    torque: float


BothContacts = tuple[ContactMotion | None, ContactMotion | None]
_Rates = tuple[float, float, float, float, float]  # ax, ay, alpha0, f1, f2
_Planes = tuple[tuple[float, float], tuple[float, float]]  # of each palm: slope (rad), height over the hinge (m)
_TABLE_HZ = (13.7, 24.1, 37.9)  # vibration of a lab's floor and machines, with equal amplitudes
_FLAT: _Planes = ((0.0, 0.0), (0.0, 0.0))
_NO_FORCE = UnitForce(0.0, 0.0, 0.0)


def random_surface(kind: Kind, rng: np.random.Generator) -> FrictionSurface:
    """Friction for bodies of the kind: light damping alone for `nominal`, else friction with dither."""
    if kind == "nominal":
        return FrictionSurface(damping=float(rng.uniform(3.5e-4, 7.5e-4)))
    return FrictionSurface(mu=float(rng.uniform(0.04, 0.25)), dither=float(rng.uniform(8e-3, 20e-3)))


def palm_frame(hinge: Hinge, palms: PalmMotion, planes: _Planes = _FLAT) -> PalmFrame:
    """The palm frame for palms that the planes of these slopes and heights represent."""
    (phi1, phi2), (w1, w2), (a1, a2) = palms.angles, palms.rates, palms.accelerations
    (slope1, above1), (slope2, above2) = planes
    c1, s1 = math.cos(phi1), math.sin(phi1)
    ox, oy = hinge.base
    vox = voy = aox = aoy = 0.0
    if hinge.mode == "arc":
        length = hinge.palm1_length
        ox -= length * c1
        oy -= length * s1
        vox, voy = length * w1 * s1, -length * w1 * c1
        aox, aoy = length * (a1 * s1 + w1 * w1 * c1), length * (w1 * w1 * s1 - a1 * c1)
    phi1, phi12 = phi1 + slope1, phi1 + phi2 - slope2
    if slope1:
        c1, s1 = math.cos(phi1), math.sin(phi1)
    one = PalmLine(c1, s1, phi1 - 0.5 * math.pi, w1, a1, above1)
    two = PalmLine(-math.cos(phi12), -math.sin(phi12), phi12 + 0.5 * math.pi, w1 + w2, a1 + a2, above2)
    return PalmFrame((one, two), ox, oy, vox, voy, aox, aoy)


class PlantSettings(TypedDict, total=False):
    """Keyword arguments of every plant, see `Plant`."""

    options: PlantOptions
    imperfections: Imperfections
    gravity: float
    reach: PadPair


class Plant:
    """One body on the palms, advanced in steps of about half a millisecond by fourth-order Runge–Kutta.

    A body with flat sides takes shorter steps while it turns fast: it passes a flat within 2 mrad, and a step that
    skipped the flat would throw the body off the palms.

    Contacts open and close between steps only: a contact with a negative force opens, a closing gap is an inelastic
    impact. A body whose contact leaves the palm's reach (0…`reach` m from the hinge) falls off and stays off until
    `place` is called.
    """

    def __init__(
        self,
        body: Body,
        hinge: Hinge,
        surface: FrictionSurface,
        *,
        options: PlantOptions = AS_ASSUMED,
        imperfections: Imperfections = PERFECT,
        gravity: float = 9.81,
        reach: PadPair = (PAD_LENGTH, PAD_LENGTH),
    ) -> None:
        """Of `imperfections`, friction, pads and vibration act here; the caller passes true angles and gravity."""
        self.body = body
        self.hinge = hinge if options.hinge_travels else Hinge("fixed", hinge.palm1_length, hinge.base)
        self.surface = surface
        self._frictions = 1.0 + imperfections.friction, 1.0 - imperfections.friction
        self._pads = imperfections.pads
        self._bowed = any(pad.sagitta for pad in self._pads)
        self._planes = self._planes_at([0.5 * length for length in reach], reach)
        self.gravity = gravity
        self._table_amplitude = imperfections.vibration * math.sqrt(2.0 / len(_TABLE_HZ))
        self._t = 0.0
        self.reach = reach
        self.fallen = True
        self.state = BodyState(0.0, 0.0, 0.0)
        self._on = [False, False]  # which contacts are closed
        self._frame = palm_frame(self.hinge, PalmMotion.at_rest((0.8, 1.6)))
        self._rates: _Rates = (0.0, 0.0, 0.0, 0.0, 0.0)

    # -- placement and state ------------------------------------------------------------------------------

    def place(self, palms: PalmMotion, psi: float, omega0: float = 0.0) -> None:
        """Place the body on both palms at angle psi (rad), turning at omega0 (rad/s), with both gaps closed."""
        for _ in range(_PLACEMENT_ROUNDS if self._bowed else 1):
            frame = self._frame = palm_frame(self.hinge, palms, self._planes)
            x, y = _com_in_contact(self.body, frame, psi)
            state = self.state = BodyState(x, y, psi, 0.0, 0.0, omega0)
            self._update_tangent_planes()
        rate1, rate2 = self._gap_rates(frame, state)
        state.vx, state.vy = _cross_solve(frame, -rate1, -rate2)
        self._on = [True, True]
        self.fallen = False
        self._settle_contacts()

    def status(self) -> dict[str, float]:
        """Additional entries of the rig's status."""
        return {}

    @property
    def mean_omega0(self) -> float:
        """The body's rate (rad/s), without the ripple of a vibration."""
        return self.state.omega0

    @property
    def touching(self) -> tuple[bool, bool]:
        """Whether the body touches palm 1, palm 2."""
        one, two = self._on
        return one, two

    def contacts(self) -> tuple[PlantContact, PlantContact]:
        """Both present contacts; `touching` is False where there is a gap or the body has fallen."""
        one, two = map(PlantContact, self._on, self._distances(), self.least_forces)
        return one, two

    @property
    def least_forces(self) -> tuple[float, float]:
        """Smallest force (N) of each contact during the last step, also within a vibration period."""
        _, _, _, f1, f2 = self._rates
        return self.body.mass * f1, self.body.mass * f2

    def contact_rates(self) -> tuple[float, float]:
        """Speeds of both contacts along the palms, away from the hinge (m/s)."""
        q, frame, at = self.state, self._frame, self.body.support.at
        rx, ry, ux, uy = q.x - frame.ox, q.y - frame.oy, q.vx - frame.vox, q.vy - frame.voy
        one, two = (
            tx * ux + ty * uy + turn * (tx * ry - ty * rx) + at(out - q.psi)[2] * (turn - q.omega0)
            for tx, ty, out, turn, _, _ in frame.palms
        )
        return one, -two

    def radii(self) -> tuple[float, float]:
        """r1 and r2 (m): the support function at both contact normals."""
        one, two = (self.body.support.at(palm.out - self.state.psi)[0] for palm in self._frame.palms)
        return one, two

    def energy(self) -> float:
        """Kinetic and potential energy per unit mass (m²/s²)."""
        q = self.state
        kinetic = 0.5 * (q.vx**2 + q.vy**2 + (self.body.rho * q.omega0) ** 2)
        return kinetic + self.gravity * q.y

    # -- time steps ---------------------------------------------------------------------------------------

    def take_away(self) -> None:
        """Remove the body from the palms until it is placed again."""
        self.fallen = True
        self._on = [False, False]
        self._rates = (0.0, 0.0, 0.0, 0.0, 0.0)

    def advance(self, middle: PalmMotion, end: PalmMotion, dt: float) -> None:
        """Advance by dt seconds; `middle` and `end` are the palms half-way and at the end."""
        remaining = dt
        while not self.fallen and (step := self._longest_step()) < remaining:
            remaining -= step
            self._step(_extrapolated_back(end, remaining + 0.5 * step), _extrapolated_back(end, remaining), step)
        self._step(middle if remaining == dt else _extrapolated_back(end, 0.5 * remaining), end, remaining)

    def _longest_step(self) -> float:
        """Longest Runge–Kutta step (s) at the body's present rate on the palms."""
        q, smooth_range = self.state, self.body.support.room
        one, two = (
            smooth_range(palm.out - q.psi) / max(abs(palm.turn - q.omega0), _MIN_RATE) for palm in self._frame.palms
        )
        return max(min(one, two), _MIN_STEP_S)

    def _step(self, middle: PalmMotion, end: PalmMotion, dt: float) -> None:
        """One Runge–Kutta step."""
        if self.fallen:
            self._frame = palm_frame(self.hinge, end, self._planes)
            return
        self._t += dt
        self._update_tangent_planes()
        self._integrate(middle, end, dt)
        self._settle_contacts()

    def _integrate(self, middle: PalmMotion, end: PalmMotion, dt: float) -> None:
        """Integrate state and palms over dt, without changes of the contacts."""
        q, half, sixth = self.state, 0.5 * dt, dt / 6.0
        mid, last = palm_frame(self.hinge, middle, self._planes), palm_frame(self.hinge, end, self._planes)
        ax1, ay1, al1, _, _ = rates1 = self._rates
        q2 = _ahead(q, q, rates1, half)
        ax2, ay2, al2, _, _ = rates2 = self._solve(mid, q2)
        q3 = _ahead(q, q2, rates2, half)
        ax3, ay3, al3, _, _ = rates3 = self._solve(mid, q3)
        q4 = _ahead(q, q3, rates3, dt)
        ax4, ay4, al4, _, _ = self._solve(last, q4)
        q.x += sixth * (q.vx + 2.0 * (q2.vx + q3.vx) + q4.vx)
        q.y += sixth * (q.vy + 2.0 * (q2.vy + q3.vy) + q4.vy)
        q.psi += sixth * (q.omega0 + 2.0 * (q2.omega0 + q3.omega0) + q4.omega0)
        q.vx += sixth * (ax1 + 2.0 * (ax2 + ax3) + ax4)
        q.vy += sixth * (ay1 + 2.0 * (ay2 + ay3) + ay4)
        q.omega0 += sixth * (al1 + 2.0 * (al2 + al3) + al4)
        self._frame = last

    def _update_tangent_planes(self) -> None:
        """For bowed palms, update the tangent planes at the points nearest to the body."""
        if self._bowed:
            self._planes = self._planes_at(_contact_distances(self.body, self._frame, self.state), self.reach)

    def _planes_at(self, distances: Iterable[float], reach: PadPair) -> _Planes:
        one, two = (
            pad.tangent_plane(min(max(s, 0.0), length), length)
            for pad, s, length in zip(self._pads, distances, reach, strict=True)
        )
        return one, two

    def _settle_contacts(self) -> None:
        """Make the contacts consistent with gaps and forces, and compute the accelerations for the next step."""
        self._close_gaps()
        rates = self._accelerations()
        while (forces := {i: rates[3 + i] for i in (0, 1) if self._on[i]}) and min(forces.values()) < 0.0:
            self._on[min(forces, key=forces.__getitem__)] = False
            rates = self._accelerations()
        self._rates = rates
        self._drop_if_off_the_palms()

    def _accelerations(self) -> _Rates:
        return self._solve(self._frame, self.state)

    def _close_gaps(self) -> None:
        """Turn each gap that has closed into a contact, with an inelastic impact."""
        if all(self._on):
            return
        q, frame = self.state, self._frame
        gaps = self._gaps(frame, q)
        on = [was_on or gap < 0.0 for was_on, gap in zip(self._on, gaps, strict=True)]
        if on == self._on:
            return
        self._on = on
        dx, dy = self._displacement_for_gaps(
            frame, q, *(-gap if closed else 0.0 for gap, closed in zip(gaps, on, strict=True))
        )
        q.x, q.y = q.x + dx, q.y + dy
        self._impact()

    def _impact(self) -> None:
        """Apply frictionless normal impulses that stop the approach of the closed contacts."""
        q, frame = self.state, self._frame
        (n1x, n1y, d1), (n2x, n2y, d2) = self._levers(frame, q)
        j = 1.0 / self.body.rho**2
        a11, a22 = 1.0 + d1 * d1 * j, 1.0 + d2 * d2 * j
        a12 = n1x * n2x + n1y * n2y + d1 * d2 * j
        rate1, rate2 = self._gap_rates(frame, q)
        alone1, alone2 = max(-rate1 / a11, 0.0), max(-rate2 / a22, 0.0)
        if not all(self._on):
            p1, p2 = (alone1, 0.0) if self._on[0] else (0.0, alone2)
        else:
            p1, p2 = closing_forces(a11, a12, a12, a22, rate1, rate2)
            if min(p1, p2) < 0.0 and min(rate1, rate2) < -_SOFT_IMPACT:
                # one of the two would have to pull: it opens, and the other takes the whole impact
                p1, p2 = (alone1, 0.0) if p2 < p1 else (0.0, alone2)
        q.vx += p1 * n1x + p2 * n2x
        q.vy += p1 * n1y + p2 * n2y
        q.omega0 += (p1 * d1 + p2 * d2) * j
        rates = self._gap_rates(frame, q)
        self._on = [on and rate <= _SEPARATION_SPEED for on, rate in zip(self._on, rates, strict=True)]

    def _distances(self) -> tuple[float, float]:
        return _contact_distances(self.body, self._frame, self.state)

    def _gaps(self, frame: PalmFrame, q: BodyState) -> tuple[float, float]:
        """Clearances to palm 1 and palm 2 (m), negative when overlapping."""
        rx, ry, at = q.x - frame.ox, q.y - frame.oy, self.body.support.at
        one, two = (tx * ry - ty * rx - at(out - q.psi)[0] - above for tx, ty, out, _, _, above in frame.palms)
        return one, two

    def _displacement_for_gaps(self, frame: PalmFrame, q: BodyState, a: float, b: float) -> tuple[float, float]:
        """The displacement (m) by which gap 1 grows by `a` and gap 2 by `b` (m)."""
        del q
        return _cross_solve(frame, a, b)

    def _levers(self, frame: PalmFrame, q: BodyState) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """The palms' normals at the contacts, and the lever arm of a force along each."""
        one, two = ((-palm.ty, palm.tx, self.body.support.at(palm.out - q.psi)[1]) for palm in frame.palms)
        return one, two

    def _gap_rates(self, frame: PalmFrame, q: BodyState) -> tuple[float, float]:
        rx, ry, ux, uy = q.x - frame.ox, q.y - frame.oy, q.vx - frame.vox, q.vy - frame.voy
        one, two = (
            tx * uy - ty * ux - turn * (tx * rx + ty * ry) - self.body.support.at(out - q.psi)[1] * (turn - q.omega0)
            for tx, ty, out, turn, _, _ in frame.palms
        )
        return one, two

    def _drop_if_off_the_palms(self) -> None:
        q, frame = self.state, self._frame
        each = zip(self._on, self._distances(), self.reach, strict=True)
        is_off = any(on and not 0.0 < s < reach for on, s, reach in each)
        if is_off or math.hypot(q.x - frame.ox, q.y - frame.oy) > _FALLEN_DISTANCE:
            self.take_away()

    # -- equations ----------------------------------------------------------------------------------------

    def _solve(self, frame: PalmFrame, q: BodyState) -> _Rates:
        """Accelerations of the COM and of ψ, and both contact forces per unit mass, for the present contacts.

        The gaps' second derivatives are linear in the forces, γ̈ = A·f + b, and are required to be zero up to the
        drift correction; friction enters A because it is proportional to the normal force.
        """
        rho2 = self.body.rho**2
        contacts = self._contacts_at(frame, q)
        first, second = (
            unit_force(at, friction * self._friction(at.slip)) if at else _NO_FORCE
            for at, friction in zip(contacts, self._frictions, strict=True)
        )
        one, two = contacts
        a11, a12, b1 = 1.0, 0.0, 0.0
        if one:
            a11, a12, b1 = 1.0 + one.slope * first.torque / rho2, gap_response(one, second, rho2), one.gap_acceleration
        a21, a22, b2 = 0.0, 1.0, 0.0
        if two:
            a21, a22, b2 = gap_response(two, first, rho2), 1.0 + two.slope * second.torque / rho2, two.gap_acceleration
        f1, f2 = closing_forces(a11, a12, a21, a22, b1, b2)
        return (
            f1 * first.fx + f2 * second.fx,
            -self._gravity_now() + f1 * first.fy + f2 * second.fy,
            -self.surface.damping * q.omega0 / rho2 + (f1 * first.torque + f2 * second.torque) / rho2,
            f1,
            f2,
        )

    def _contacts_at(self, frame: PalmFrame, q: BodyState) -> BothContacts:
        one, two = (
            self._contact(frame, q, palm) if on else None for on, palm in zip(self._on, frame.palms, strict=True)
        )
        return one, two

    def _contact(self, frame: PalmFrame, q: BodyState, palm: PalmLine) -> ContactMotion:
        tx, ty, out, turn, alpha, above = palm
        rx, ry, ux, uy = q.x - frame.ox, q.y - frame.oy, q.vx - frame.vox, q.vy - frame.voy
        gx, gy, w = -frame.aox, -self._gravity_now() - frame.aoy, q.omega0
        damping = -self.surface.damping * w / self.body.rho**2
        h, slope, bend = self.body.support.at(out - q.psi)
        spin, along, over = turn - w, tx * rx + ty * ry, tx * ry - ty * rx
        tangential, normal_speed = tx * ux + ty * uy, tx * uy - ty * ux
        # slip of the body's material relative to the palm's, at the contact x = −h·n + h′·t
        rate, slip = normal_speed - turn * along - slope * spin, tangential + w * h + turn * (over - h)
        gap_acceleration = (
            tx * gy - ty * gx - 2.0 * turn * tangential - alpha * along - turn * turn * over - bend * spin * spin
            - slope * (alpha - damping) + _DRIFT_RATE * (2.0 * rate + _DRIFT_RATE * (over - h - above))
        )  # fmt: skip
        slip_rate = (
            tx * gx + ty * gy + turn * normal_speed + w * slope * spin + h * damping + alpha * (over - h)
            + turn * rate + _DRIFT_RATE * slip
        )  # fmt: skip
        return ContactMotion(tx, ty, h, slope, gap_acceleration, slip_rate, slip)

    def _gravity_now(self) -> float:
        if not self._table_amplitude:
            return self.gravity
        sines = 0.0
        for f in _TABLE_HZ:
            sines += math.sin(math.tau * f * self._t)
        return self.gravity + self._table_amplitude * sines  # on the table

    def _friction(self, slip: float) -> float:
        """Tangential over normal force at a slip speed (m/s): µ·u/√(u²+u_d²)."""
        surface = self.surface
        if surface.mu == 0.0:
            return 0.0
        return surface.mu * slip / math.sqrt(slip * slip + surface.dither * surface.dither)


def _extrapolated_back(end: PalmMotion, by: float) -> PalmMotion:
    """The palms `by` seconds earlier within a step, for constant accelerations."""
    accelerations = end.accelerations
    rates = tuple(w - a * by for w, a in zip(end.rates, accelerations, strict=True))
    angles = tuple(
        phi - (w - 0.5 * a * by) * by for phi, w, a in zip(end.angles, end.rates, accelerations, strict=True)
    )
    return PalmMotion(angles, rates, accelerations)


def _ahead(q: BodyState, by: BodyState, rates: _Rates, dt: float) -> BodyState:
    """The state dt seconds after q, by the velocities of `by` and these accelerations."""
    ax, ay, alpha, _, _ = rates
    return BodyState(
        q.x + dt * by.vx,
        q.y + dt * by.vy,
        q.psi + dt * by.omega0,
        q.vx + dt * ax,
        q.vy + dt * ay,
        q.omega0 + dt * alpha,
    )


def unit_force(at: ContactMotion, ratio: float) -> UnitForce:
    """The effect of a unit normal force with friction `ratio` times as large against t."""
    return UnitForce(-at.ty - ratio * at.tx, at.tx - ratio * at.ty, at.slope - ratio * at.h)


def gap_response(at: ContactMotion, by: UnitForce, rho2: float) -> float:
    """The acceleration of a contact's gap due to a force on the body."""
    return at.tx * by.fy - at.ty * by.fx + at.slope * by.torque / rho2


def closing_forces(a11: float, a12: float, a21: float, a22: float, b1: float, b2: float) -> tuple[float, float]:
    """The forces f for which A·f + b = 0."""
    det = a11 * a22 - a12 * a21
    return (a12 * b2 - a22 * b1) / det, (a21 * b1 - a11 * b2) / det


def _cross_solve(frame: PalmFrame, a: float, b: float) -> tuple[float, float]:
    """The vector p with n1·p = a and n2·p = b."""
    one, two = frame.palms
    sin_phi2 = one.ty * two.tx - one.tx * two.ty
    return (b * one.tx - a * two.tx) / sin_phi2, (b * one.ty - a * two.ty) / sin_phi2


def _com_in_contact(body: Body, frame: PalmFrame, psi: float) -> tuple[float, float]:
    """Position of the COM when the body touches both palms at angle psi."""
    x, y = _cross_solve(frame, *(body.support.at(palm.out - psi)[0] + palm.above for palm in frame.palms))
    return frame.ox + x, frame.oy + y


def _contact_distances(body: Body, frame: PalmFrame, q: BodyState) -> tuple[float, float]:
    """Distance from the hinge, along each palm, of the body's nearest point (m)."""
    rx, ry = q.x - frame.ox, q.y - frame.oy
    one, two = (palm.tx * rx + palm.ty * ry + body.support.at(palm.out - q.psi)[1] for palm in frame.palms)
    return one, -two


def stable_poses(body: Body, palms: PalmMotion) -> list[float]:
    """The angles ψ in [0, 2π) at which the COM's height has a local minimum (rad), the lowest first.

    A disc is in equilibrium at any angle; 0 represents all of them.
    """
    frame = palm_frame(Hinge("fixed"), palms)
    count = 360
    heights = [_com_in_contact(body, frame, math.tau * i / count)[1] for i in range(count)]
    if max(heights) - min(heights) < _LEVEL_TOLERANCE:
        return [0.0]
    minima = [i for i in range(count) if heights[i - 1] > heights[i] <= heights[(i + 1) % count]]
    minima.sort(key=heights.__getitem__)
    return [_lowest(body, frame, math.tau * i / count, math.tau / count) for i in minima]


def _lowest(body: Body, frame: PalmFrame, psi: float, width: float) -> float:
    """The height's minimum within ±width of psi, where dy/dψ = −(h1′ sin φ12 + h2′ sin φ1)/sin φ2 is zero."""
    at, (one, two) = body.support.at, frame.palms
    low, high = psi - width, psi + width
    for _ in range(50):
        middle = 0.5 * (low + high)
        slope = at(one.out - middle)[1] * two.ty - at(two.out - middle)[1] * one.ty
        low, high = (middle, high) if slope < 0.0 else (low, middle)
    return (0.5 * (low + high)) % math.tau
