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


class PalmFrame(NamedTuple):
    """What the equations need of the palms at one instant; a tuple because it is unpacked 8000 times a second.

    Cosine and sine of both palms' directions (φ1, φ12), the directions of the body's outward normals at the contacts,
    the palms' rates and accelerations, the hinge's position, velocity and acceleration, and the height of each palm's
    plane over the hinge, on the object's side. SI, world.
    """

    c1: float
    s1: float
    c12: float
    s12: float
    out1: float
    out2: float
    w1: float
    w12: float
    al1: float
    al12: float
    ox: float
    oy: float
    vox: float
    voy: float
    aox: float
    aoy: float
    above1: float
    above2: float

    def each(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """For each palm: its tangent (x, y), the normal's direction, rate, acceleration, and the plane's height."""
        return (
            (self.c1, self.s1, self.out1, self.w1, self.al1, self.above1),
            (-self.c12, -self.s12, self.out2, self.w12, self.al12, self.above2),
        )


_Rates = tuple[float, float, float, float, float]  # ax, ay, alpha0, f1, f2
_Planes = tuple[tuple[float, float], tuple[float, float]]  # of each palm: slope (rad), height over the hinge (m)
_TABLE_HZ = (13.7, 24.1, 37.9)  # vibration of a lab's floor and machines, with equal amplitudes
_FLAT: _Planes = ((0.0, 0.0), (0.0, 0.0))


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
    return PalmFrame(
        c1, s1, math.cos(phi12), math.sin(phi12), phi1 - 0.5 * math.pi, phi12 + 0.5 * math.pi,
        w1, w1 + w2, a1, a1 + a2, ox, oy, vox, voy, aox, aoy, above1, above2,
    )  # fmt: skip


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
        self._friction1, self._friction2 = 1.0 + imperfections.friction, 1.0 - imperfections.friction
        self._frictions = self._friction1, self._friction2
        self._pads = imperfections.pads
        self._bowed = any(pad.sagitta for pad in self._pads)
        self._planes = self._planes_at([0.5 * length for length in reach], reach)
        self.gravity = gravity
        self._table_amplitude = imperfections.vibration * math.sqrt(2.0 / len(_TABLE_HZ))
        self._t = 0.0
        self.reach = reach
        self.fallen = True
        self.state = BodyState(0.0, 0.0, 0.0)
        self._on1 = self._on2 = False
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
        self._on1 = self._on2 = True
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
        return self._on1, self._on2

    def contacts(self) -> tuple[PlantContact, PlantContact]:
        """Both present contacts; `touching` is False where there is a gap or the body has fallen."""
        s1, s2 = self._distances()
        _, _, _, f1, f2 = self._rates
        mass = self.body.mass
        return PlantContact(self._on1, s1, mass * f1), PlantContact(self._on2, s2, mass * f2)

    @property
    def least_forces(self) -> tuple[float, float]:
        """Smallest force (N) of each contact during the last step, also within a vibration period."""
        _, _, _, f1, f2 = self._rates
        return self.body.mass * f1, self.body.mass * f2

    def contact_rates(self) -> tuple[float, float]:
        """Speeds of both contacts along the palms, away from the hinge (m/s)."""
        q, at = self.state, self.body.support.at
        c1, s1, c12, s12, out1, out2, w1, w12, _, _, ox, oy, vox, voy, *_ = self._frame
        rx, ry, ux, uy = q.x - ox, q.y - oy, q.vx - vox, q.vy - voy
        h1pp, h2pp = at(out1 - q.psi)[2], at(out2 - q.psi)[2]
        return (
            c1 * ux + s1 * uy + w1 * (c1 * ry - s1 * rx) + h1pp * (w1 - q.omega0),
            c12 * ux + s12 * uy - w12 * (s12 * rx - c12 * ry) - h2pp * (w12 - q.omega0),
        )

    def radii(self) -> tuple[float, float]:
        """r1 and r2 (m): the support function at both contact normals."""
        at, psi = self.body.support.at, self.state.psi
        return at(self._frame.out1 - psi)[0], at(self._frame.out2 - psi)[0]

    def energy(self) -> float:
        """Kinetic and potential energy per unit mass (m²/s²)."""
        q = self.state
        kinetic = 0.5 * (q.vx**2 + q.vy**2 + (self.body.rho * q.omega0) ** 2)
        return kinetic + self.gravity * q.y

    # -- time steps ---------------------------------------------------------------------------------------

    def take_away(self) -> None:
        """Remove the body from the palms until it is placed again."""
        self.fallen = True
        self._on1 = self._on2 = False
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
        frame, q, smooth_range = self._frame, self.state, self.body.support.room
        one = smooth_range(frame.out1 - q.psi) / max(abs(frame.w1 - q.omega0), _MIN_RATE)
        two = smooth_range(frame.out2 - q.psi) / max(abs(frame.w12 - q.omega0), _MIN_RATE)
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
        q = self.state
        x, y, psi, vx, vy, w = q.x, q.y, q.psi, q.vx, q.vy, q.omega0
        half, sixth = 0.5 * dt, dt / 6.0
        mid, last = palm_frame(self.hinge, middle, self._planes), palm_frame(self.hinge, end, self._planes)
        ax1, ay1, al1, _, _ = self._rates
        vx2, vy2, w2 = vx + half * ax1, vy + half * ay1, w + half * al1
        ax2, ay2, al2, _, _ = self._solve(mid, x + half * vx, y + half * vy, psi + half * w, vx2, vy2, w2)
        vx3, vy3, w3 = vx + half * ax2, vy + half * ay2, w + half * al2
        ax3, ay3, al3, _, _ = self._solve(mid, x + half * vx2, y + half * vy2, psi + half * w2, vx3, vy3, w3)
        vx4, vy4, w4 = vx + dt * ax3, vy + dt * ay3, w + dt * al3
        ax4, ay4, al4, _, _ = self._solve(last, x + dt * vx3, y + dt * vy3, psi + dt * w3, vx4, vy4, w4)
        q.x = x + sixth * (vx + 2.0 * (vx2 + vx3) + vx4)
        q.y = y + sixth * (vy + 2.0 * (vy2 + vy3) + vy4)
        q.psi = psi + sixth * (w + 2.0 * (w2 + w3) + w4)
        q.vx = vx + sixth * (ax1 + 2.0 * (ax2 + ax3) + ax4)
        q.vy = vy + sixth * (ay1 + 2.0 * (ay2 + ay3) + ay4)
        q.omega0 = w + sixth * (al1 + 2.0 * (al2 + al3) + al4)
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
        while (self._on1 and rates[3] < 0.0) or (self._on2 and rates[4] < 0.0):
            if self._on1 and (rates[3] <= rates[4] or not self._on2):
                self._on1 = False
            else:
                self._on2 = False
            rates = self._accelerations()
        self._rates = rates
        self._drop_if_off_the_palms()

    def _accelerations(self) -> _Rates:
        q = self.state
        return self._solve(self._frame, q.x, q.y, q.psi, q.vx, q.vy, q.omega0)

    def _close_gaps(self) -> None:
        """Turn each gap that has closed into a contact, with an inelastic impact."""
        if self._on1 and self._on2:
            return
        q, frame = self.state, self._frame
        gap1, gap2 = self._gaps(frame, q)
        hit1, hit2 = not self._on1 and gap1 < 0.0, not self._on2 and gap2 < 0.0
        if not (hit1 or hit2):
            return
        self._on1, self._on2 = self._on1 or hit1, self._on2 or hit2
        dx, dy = self._displacement_for_gaps(frame, q, -gap1 if self._on1 else 0.0, -gap2 if self._on2 else 0.0)
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
        if not (self._on1 and self._on2):
            p1, p2 = (alone1, 0.0) if self._on1 else (0.0, alone2)
        else:
            det = a11 * a22 - a12 * a12
            p1, p2 = (a12 * rate2 - a22 * rate1) / det, (a12 * rate1 - a11 * rate2) / det
            if min(p1, p2) < 0.0 and min(rate1, rate2) < -_SOFT_IMPACT:
                # one of the two would have to pull: it opens, and the other takes the whole impact
                p1, p2 = (alone1, 0.0) if p2 < p1 else (0.0, alone2)
        q.vx += p1 * n1x + p2 * n2x
        q.vy += p1 * n1y + p2 * n2y
        q.omega0 += (p1 * d1 + p2 * d2) * j
        rate1, rate2 = self._gap_rates(frame, q)
        self._on1, self._on2 = self._on1 and rate1 <= _SEPARATION_SPEED, self._on2 and rate2 <= _SEPARATION_SPEED

    def _distances(self) -> tuple[float, float]:
        return _contact_distances(self.body, self._frame, self.state)

    def _gaps(self, frame: PalmFrame, q: BodyState) -> tuple[float, float]:
        return _gaps(self.body, frame, q)

    def _displacement_for_gaps(self, frame: PalmFrame, q: BodyState, a: float, b: float) -> tuple[float, float]:
        """The displacement (m) by which gap 1 grows by `a` and gap 2 by `b` (m)."""
        del q
        return _cross_solve(frame, a, b)

    def _levers(self, frame: PalmFrame, q: BodyState) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """The palms' normals at the contacts, and the lever arm of a force along each."""
        (n1x, n1y), (n2x, n2y) = _normals(frame)
        at, psi = self.body.support.at, q.psi
        return (n1x, n1y, at(frame.out1 - psi)[1]), (n2x, n2y, at(frame.out2 - psi)[1])

    def _gap_rates(self, frame: PalmFrame, q: BodyState) -> tuple[float, float]:
        c1, s1, c12, s12, out1, out2, w1, w12, _, _, ox, oy, vox, voy, *_ = frame
        rx, ry, ux, uy = q.x - ox, q.y - oy, q.vx - vox, q.vy - voy
        _, h1_slope, _ = self.body.support.at(out1 - q.psi)
        _, h2_slope, _ = self.body.support.at(out2 - q.psi)
        rate1 = c1 * uy - s1 * ux - w1 * (c1 * rx + s1 * ry) - h1_slope * (w1 - q.omega0)
        rate2 = s12 * ux - c12 * uy + w12 * (c12 * rx + s12 * ry) - h2_slope * (w12 - q.omega0)
        return rate1, rate2

    def _drop_if_off_the_palms(self) -> None:
        q, frame = self.state, self._frame
        s1, s2 = self._distances()
        off1 = self._on1 and not 0.0 < s1 < self.reach[0]
        off2 = self._on2 and not 0.0 < s2 < self.reach[1]
        if off1 or off2 or math.hypot(q.x - frame.ox, q.y - frame.oy) > _FALLEN_DISTANCE:
            self.take_away()

    def _solve(self, frame: PalmFrame, x: float, y: float, psi: float, vx: float, vy: float, w: float) -> _Rates:
        """Accelerations of the COM and of ψ, and both contact forces per unit mass, for the present contacts.

        The gaps' second derivatives are linear in the forces, γ̈ = A·f + b, and are required to be zero up to the
        drift correction; friction enters A because it is proportional to the normal force.
        """
        c1, s1, c12, s12, out1, out2, w1, w12, al1, al12, ox, oy, vox, voy, aox, aoy, above1, above2 = frame
        g = self._gravity_now()
        rho2 = self.body.rho**2
        surface = self.surface
        damping = -surface.damping * w / rho2
        on1, on2 = self._on1, self._on2
        f1 = f2 = 0.0
        rx, ry, ux, uy = x - ox, y - oy, vx - vox, vy - voy
        gx, gy = -aox, -g - aoy
        at = self.body.support.at
        if on1:
            h1, h1p, h1pp = at(out1 - psi)
            along = c1 * rx + s1 * ry
            normal = c1 * ry - s1 * rx
            spin = w1 - w
            rate = c1 * uy - s1 * ux - w1 * along - h1p * spin
            b1 = (
                c1 * gy - s1 * gx - 2.0 * w1 * (c1 * ux + s1 * uy) - al1 * along - w1 * w1 * normal
                - h1pp * spin * spin - h1p * (al1 - damping)
                + _DRIFT_RATE * (2.0 * rate + _DRIFT_RATE * (normal - h1 - above1))
            )  # fmt: skip
            # slip of the body's material along t1 relative to the palm's, at the contact x1 = −h·n1 + h′·t1
            k1 = self._friction1 * self._friction(c1 * ux + s1 * uy + w * h1 + w1 * (normal - h1))
            f1x, f1y = -s1 - k1 * c1, c1 - k1 * s1
            m1 = h1p - k1 * h1
        if on2:
            h2, h2p, h2pp = at(out2 - psi)
            along = c12 * rx + s12 * ry
            normal = s12 * rx - c12 * ry
            spin = w12 - w
            rate = s12 * ux - c12 * uy + w12 * along - h2p * spin
            b2 = (
                s12 * gx - c12 * gy + 2.0 * w12 * (c12 * ux + s12 * uy) + al12 * along - w12 * w12 * normal
                - h2pp * spin * spin - h2p * (al12 - damping)
                + _DRIFT_RATE * (2.0 * rate + _DRIFT_RATE * (normal - h2 - above2))
            )  # fmt: skip
            k2 = self._friction2 * self._friction(-c12 * ux - s12 * uy + w * h2 + w12 * (normal - h2))
            f2x, f2y = s12 + k2 * c12, -c12 + k2 * s12
            m2 = h2p - k2 * h2
        ax, ay, al = 0.0, -g, damping
        if on1 and on2:
            a11, a22 = 1.0 + h1p * m1 / rho2, 1.0 + h2p * m2 / rho2
            a12 = c1 * f2y - s1 * f2x + h1p * m2 / rho2
            a21 = s12 * f1x - c12 * f1y + h2p * m1 / rho2
            det = a11 * a22 - a12 * a21
            f1, f2 = (a12 * b2 - a22 * b1) / det, (a21 * b1 - a11 * b2) / det
            return f1 * f1x + f2 * f2x, ay + f1 * f1y + f2 * f2y, al + (f1 * m1 + f2 * m2) / rho2, f1, f2
        if on1:
            f1 = -b1 / (1.0 + h1p * m1 / rho2)
            ax, ay, al = f1 * f1x, ay + f1 * f1y, al + f1 * m1 / rho2
        elif on2:
            f2 = -b2 / (1.0 + h2p * m2 / rho2)
            ax, ay, al = f2 * f2x, ay + f2 * f2y, al + f2 * m2 / rho2
        return ax, ay, al, f1, f2

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


def _normals(frame: PalmFrame) -> tuple[tuple[float, float], tuple[float, float]]:
    """The palms' normals into the space between them, n1 and n2."""
    return (-frame.s1, frame.c1), (frame.s12, -frame.c12)


def _cross_solve(frame: PalmFrame, a: float, b: float) -> tuple[float, float]:
    """The vector p with n1·p = a and n2·p = b."""
    c1, s1, c12, s12 = frame.c1, frame.s1, frame.c12, frame.s12
    sin_phi2 = c1 * s12 - s1 * c12
    return (a * c12 + b * c1) / sin_phi2, (a * s12 + b * s1) / sin_phi2


def _com_in_contact(body: Body, frame: PalmFrame, psi: float) -> tuple[float, float]:
    """Position of the COM when the body touches both palms at angle psi."""
    one, two = body.support.at(frame.out1 - psi)[0], body.support.at(frame.out2 - psi)[0]
    x, y = _cross_solve(frame, one + frame.above1, two + frame.above2)
    return frame.ox + x, frame.oy + y


def _gaps(body: Body, frame: PalmFrame, q: BodyState) -> tuple[float, float]:
    """Clearances to palm 1 and palm 2 (m), negative when overlapping."""
    c1, s1, c12, s12, out1, out2 = frame[:6]
    rx, ry = q.x - frame.ox, q.y - frame.oy
    return (
        c1 * ry - s1 * rx - body.support.at(out1 - q.psi)[0] - frame.above1,
        s12 * rx - c12 * ry - body.support.at(out2 - q.psi)[0] - frame.above2,
    )


def _contact_distances(body: Body, frame: PalmFrame, q: BodyState) -> tuple[float, float]:
    """Distance from the hinge, along each palm, of the body's nearest point (m)."""
    c1, s1, c12, s12, out1, out2 = frame[:6]
    rx, ry = q.x - frame.ox, q.y - frame.oy
    return (
        c1 * rx + s1 * ry + body.support.at(out1 - q.psi)[1],
        c12 * rx + s12 * ry - body.support.at(out2 - q.psi)[1],
    )


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
    s1, s12, out1, out2 = frame.s1, frame.s12, frame.out1, frame.out2
    low, high = psi - width, psi + width
    for _ in range(50):
        middle = 0.5 * (low + high)
        slope = -(body.support.at(out1 - middle)[1] * s12 + body.support.at(out2 - middle)[1] * s1)
        low, high = (middle, high) if slope < 0.0 else (low, middle)
    return (0.5 * (low + high)) % math.tau
