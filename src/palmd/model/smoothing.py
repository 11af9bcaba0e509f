"""Kernels of the smoother: one step of the motion, one contact reading, one force reading, each with its Jacobian.

The trajectory is given at nodes x_k = (ψ, ω0); everything constant is one vector
p = (ln ρ, B, w, c, ln m, constants of the rig, coefficients of h). Between two nodes ψ is their cubic Hermite
interpolant, so a reading at any time depends only on two neighbouring nodes and on p: the least-squares problem is
block-tridiagonal with a border.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache

from palmd.model.compiled import Library, load
from palmd.model.contact import Contact, alongs, readings, tangent_joints
from palmd.model.dynamics import VIBRATION_ERROR_INPUTS, BodyConstants, Motion, Palms, newton_euler
from palmd.model.integrate import exponential_step, variance_share
from palmd.model.kernels import Kernel, first_output, of_columns, single
from palmd.model.outputs import FRICTION_INPUT, RIG_INPUTS, touch_on
from palmd.model.shape import contact_at
from palmd.model.shape_map import PALM_INPUTS, palms_after
from palmd.model.symbolic import SX, ca
from palmd.model.touch import Touch
from palmd.system.mechanism import normal_directions
from palmd.system.rig_constants import RIG_NAMES

ORDER = 12  # harmonics of the outline; more than the live observer's, for ellipses and flat sides
NODE = 2  # ψ, ω0


RIPPLE_STEPS = 2  # `steps` of `newton_euler`


class C(IntEnum):
    """Index of each constant; SI units, logarithms of SI units.

    DRAG is B = μ/u_d (s/m), SATURATION w = 1/u_d² (s²/m²), u_d = πV/2 of palms that vibrate at speed V. Readings
    determine B, the slope of friction in slow slip, linearly, so that records which hardly determine w can be combined
    linearly.
    """

    LN_RHO = 0
    DRAG = 1
    SATURATION = 2
    DAMPING = 3
    LN_MASS = 4
    RIG = 5
    SHAPE = 24


class R(IntEnum):
    """Index of each rig constant, from `C.RIG` on: the error of a value of the rig's description; SI units.

    A pad reads ZERO + FORCE f + (1 + SCALE) s for a contact at s under a force f (N), with a delay LAG. Its surface
    lies STANDOFF above the hinge line, on the object's side, and is an arc that is SAGITTA higher in the pad's middle
    than at its ends. TILT is the error of φ1, including gravity's direction, TURN that of φ2. Palm 1's friction is
    (1 + FRICTION) μ and palm 2's (1 − FRICTION) μ. KAPPA and TRANSMISSION are the errors of κ and λ of the palms'
    vibration, PERIOD the relative error of its period (`model.friction`), ARM the relative excess of friction's lever
    arm over r. Constants of a pad: pad 2's follows pad 1's. Names: `system.rig_constants`.
    """

    ZERO = 0
    SCALE = 2
    SAGITTA = 4
    LAG = 6
    STANDOFF = 8
    TILT = 10
    TURN = 11
    FRICTION = 12
    FORCE = 13
    KAPPA = 15
    TRANSMISSION = 16
    PERIOD = 17
    ARM = 18


RIG_CONSTANTS = len(RIG_NAMES)
RIG = slice(C.RIG, C.SHAPE)
CONSTANTS = C.SHAPE + 2 * ORDER + 1
STEP_INPUTS = 1 + PALM_INPUTS + 2 + RIG_INPUTS + 2  # dt, palms, jerk, rig, the pads' lengths
CONTACT_INPUTS = 3 + 9  # dt, time into the step, pad, φ1, φ2, their rates, force, curvatures, the pads' lengths
FORCE_INPUTS = 3 + PALM_INPUTS + RIG_INPUTS + 2  # dt, time into the step, pad, palms, rig, the pads' lengths

Outline = Callable[[SX, SX], Contact]
"""Function of the outward normal and the constants from `C.SHAPE` on, like `model.shape.contact_at`."""


@dataclass(frozen=True, slots=True)
class Form:
    """Variant of the kernels: function of the outline, total number of constants, and whether palms are arcs."""

    outline: Outline = contact_at
    constants: int = CONSTANTS
    curved: bool = False


SMOOTH = Form()


@dataclass(frozen=True, slots=True)
class _ContactModel:
    """What contacts are computed from: outline function, contact search, lengths of the pads (m)."""

    outline: Outline
    touch: Touch
    lengths: SX


@dataclass(frozen=True, slots=True)
class _ContactState:
    """Contacts of an object: actual joint angles of the palms (rad), both contacts, s1 and s2 (m)."""

    joints: tuple[SX, ...]
    contacts: tuple[Contact, Contact]
    s: tuple[SX, SX]


def _contacts(phi1: SX, phi2: SX, psi: SX, p: SX, model: _ContactModel) -> _ContactState:
    """Return the contacts of an object at orientation ψ on palms reported at φ1, φ2.

    A bowed pad is replaced by its tangent plane at the contact, turned by the slope and displaced from the hinge.
    """
    rig, h = p[RIG], p[C.SHAPE :]
    joints = phi1 + rig[R.TILT], phi2 + rig[R.TURN]
    if not model.touch.flat:
        return _contacts_on_arcs(joints, psi, p, model)
    standoffs = rig[R.STANDOFF], rig[R.STANDOFF + 1]

    def planes(slopes: Sequence[SX], heights: Sequence[SX]) -> tuple[Contact, Contact]:
        turns = slopes[0], -slopes[1]
        normals = normal_directions(tangent_joints(joints, turns), psi)
        one, two = (
            replace(model.outline(theta, h), turn=turn, above=standoff + height)
            for theta, turn, standoff, height in zip(normals, turns, standoffs, heights, strict=True)
        )
        return one, two

    zeros = SX(0), SX(0)
    bows = [(rig[R.SAGITTA + i], model.lengths[i]) for i in range(2)]
    at = zip(bows, alongs(joints[1], *planes(zeros, zeros)), strict=True)
    slopes, heights = zip(
        *((4 * bow / length * (1 - 2 * s / length), 4 * bow * (s / length) ** 2) for (bow, length), s in at),
        strict=True,
    )  # height: that of the tangent at the hinge, bow height − s·slope
    one, two = planes(slopes, heights)
    return _ContactState(joints, (one, two), alongs(joints[1], one, two))


def _contacts_on_arcs(joints: tuple[SX, ...], psi: SX, p: SX, model: _ContactModel) -> _ContactState:
    """`_contacts` on curved palms: a bow adds to the curvature and is a slope at the hinge."""
    rig, h, lengths = p[RIG], p[C.SHAPE :], model.lengths
    slopes = 4 * rig[R.SAGITTA] / lengths[0], -4 * rig[R.SAGITTA + 1] / lengths[1]
    bends = [-8 * rig[R.SAGITTA + i] / lengths[i] ** 2 for i in range(2)]
    phi1, phi2 = tangent_joints(joints, slopes)

    standoffs = [rig[R.STANDOFF + i] for i in range(2)]
    one, two = model.touch.contacts(phi1, phi2, psi, lambda theta, _: model.outline(theta, h), h[0], bends, standoffs)
    turned = replace(one, turn=one.turn + slopes[0]), replace(two, turn=two.turn + slopes[1])
    return _ContactState(joints, turned, readings(phi2, one, two))


def _motion(psi: SX, omega0: SX, p: SX, palms: Palms, rig: SX, model: _ContactModel) -> Motion:
    state = _contacts(palms.phi1, palms.phi2, psi, p, model)
    dither = 1.0 / ca.sqrt(p[C.SATURATION])
    body = BodyConstants(ca.exp(p[C.LN_RHO]), p[C.DRAG] * dither, dither, p[C.DAMPING])
    errors = ca.vertsplit(p[RIG][R.KAPPA : R.ARM + 1])
    rig = ca.vertcat(
        rig[:FRICTION_INPUT], p[RIG][R.FRICTION], rig[FRICTION_INPUT + 1 : VIBRATION_ERROR_INPUTS.start], *errors
    )
    phi1, phi2 = state.joints
    return newton_euler(replace(palms, phi1=phi1, phi2=phi2), omega0, *state.contacts, body, rig, RIPPLE_STEPS)


def step_function(form: Form = SMOOTH) -> ca.Function:
    """(x_k, p, [dt, φ1 … α2, jerk1, jerk2, rig, L1, L2]) → (x after dt, its Jacobian by (x_k, p))."""
    x, p, u = SX.sym("x", NODE), SX.sym("p", form.constants), SX.sym("u", STEP_INPUTS)
    dt, palms, jerk, rig, lengths = u[0], u[1:7], u[7:9], u[9:-2], u[-2:]
    y, model = ca.vertcat(x, p), _ContactModel(form.outline, touch_on(rig, form.curved), lengths)

    def rates(moving: SX, t: SX) -> SX:
        now = _motion(moving[0], moving[1], p, palms_after(palms, jerk, t), rig, model)
        return ca.vertcat(moving[1], now.alpha0)

    at_start = _motion(x[0], x[1], p, palms_after(palms, jerk, SX(0)), rig, model)
    braking = ca.jacobian(at_start.softened_alpha0, x[1])
    moved, J = exponential_step(rates, y, dt, [0, 1], 1, braking, model.touch)
    return ca.Function("step", [x, p, u], [moved, J], ["x", "p", "u"], ["x_next", "J"])


def discrepancy_function(form: Form = SMOOTH) -> ca.Function:
    """(x_k, p, [dt, φ1 … α2, jerk1, jerk2, rig, L1, L2]) → what the friction law leaves open.

    Process noise density of ω0 ((rad/s)²/s), the part of it due to hopping contacts, and the force (m/s²) with which
    these would have to pull.
    """
    x, p, u = SX.sym("x", NODE), SX.sym("p", form.constants), SX.sym("u", STEP_INPUTS)
    palms, rig = palms_after(u[1:7], u[7:9], SX(0)), u[9:-2]
    model = _ContactModel(form.outline, touch_on(rig, form.curved), u[-2:])
    motion = _motion(x[0], x[1], p, palms, rig, model)
    braking = ca.jacobian(motion.softened_alpha0, x[1])
    q = ca.vertcat(ca.vertcat(motion.discrepancy, motion.hopping) * variance_share(braking, u[0]), motion.pulling_force)
    return ca.Function("discrepancy", [x, p, u], model.touch.thawed(q), ["x", "p", "u"], ["q"])


def _between(a: SX, b: SX, dt: SX, t: SX) -> tuple[SX, SX]:
    """(ψ, ω0) at `t` into a step of `dt` from node a to node b: cubic Hermite and its derivative."""
    u = t / dt
    psi = (1 + 2 * u) * (1 - u) ** 2 * a[0] + u**2 * (3 - 2 * u) * b[0] + dt * u * (1 - u) * ((1 - u) * a[1] - u * b[1])
    omega0 = 6 * u * (1 - u) * (b[0] - a[0]) / dt + (1 - u) * (1 - 3 * u) * a[1] + u * (3 * u - 2) * b[1]
    return psi, omega0


def contact_function(form: Form = SMOOTH) -> ca.Function:
    """(x_k, x_k+1, p, [dt, t, pad, φ1 … ω2, force, κ1 … L2]) → (the pad's reading, its gradient by (x_k, x_k+1, p))."""
    a, b, p = SX.sym("a", NODE), SX.sym("b", NODE), SX.sym("p", form.constants)
    z = SX.sym("z", CONTACT_INPUTS)
    rig = p[RIG]
    first = z[2] < 1.5

    def of_pad(which: R) -> SX:
        return ca.if_else(first, rig[which], rig[which + 1])

    lag, touch = of_pad(R.LAG), Touch(ca.vertsplit(z[8:10])) if form.curved else Touch()
    psi, _ = _between(a, b, z[0], z[1] - lag)
    s1, s2 = _contacts(z[3] - lag * z[5], z[4] - lag * z[6], psi, p, _ContactModel(form.outline, touch, z[10:])).s
    reading = of_pad(R.ZERO) + of_pad(R.FORCE) * z[7] + (1 + of_pad(R.SCALE)) * ca.if_else(first, s1, s2)
    reading, J = touch.thawed(reading, ca.jacobian(reading, ca.vertcat(a, b, p)))
    return ca.Function("contact", [a, b, p, z], [reading, J], ["a", "b", "p", "z"], ["s", "J"])


def force_function(form: Form = SMOOTH) -> ca.Function:
    """(x_k, x_k+1, p, [dt, t, pad, φ1 … α2, rig, L1, L2]) → (the pad's force (N), its gradient by (x_k, x_k+1, p))."""
    a, b, p = SX.sym("a", NODE), SX.sym("b", NODE), SX.sym("p", form.constants)
    z = SX.sym("z", FORCE_INPUTS)
    psi, omega0 = _between(a, b, z[0], z[1])
    palms = palms_after(z[3 : 3 + PALM_INPUTS], SX.zeros(2), SX(0))
    rig = z[3 + PALM_INPUTS : -2]
    touch = touch_on(rig, form.curved)
    motion = _motion(psi, omega0, p, palms, rig, _ContactModel(form.outline, touch, z[-2:]))
    force = ca.exp(p[C.LN_MASS]) * ca.if_else(z[2] < 1.5, motion.f1, motion.f2)
    force, J = touch.thawed(force, ca.jacobian(force, ca.vertcat(a, b, p)))
    return ca.Function("force", [a, b, p, z], [force, J], ["a", "b", "p", "z"], ["f", "J"])


def _kernels(form: Form) -> list[Kernel]:
    step = step_function(form)
    batched = (step, discrepancy_function(form), contact_function(form), force_function(form))
    return [*(of_columns(f, f"{f.name()}_batch", ["p"]) for f in batched), single(first_output(step, "advance"))]


@cache
def library(curved: bool = False) -> Library:
    """Load step, discrepancy, contact, force (column kernels `…_batch` with common p) and `advance`, step without J."""
    return kernels("smoothing_curved", Form(curved=True)) if curved else kernels("smoothing", SMOOTH)


def kernels(name: str, form: Form) -> Library:
    """Load the same set of kernels for another form, as library `name`."""
    return load(name, lambda: _kernels(form), written=["normal_equations.c", "palm_path.c"])
