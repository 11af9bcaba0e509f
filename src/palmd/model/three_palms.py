"""Three palms and a convex body in space as generated C: accelerations and readings with their sensitivities.

State (R, ω): rotation from body to world, and angular velocity in the world. The centre of mass p follows from the
rotation, N p = h(u) with uᵢ = −Rᵀnᵢ. Everything is per unit mass. Eliminating the contacts' own motion leaves three
linear equations in the normal forces (docs/theory/three-palms.md), singular only if the palms' normals are coplanar.
Variations of R are rotation vectors δ in the world frame, R ← exp[δ]R.

Parameters p = (c_lm, λ, damping, μ, ln u_d): `count(order)` + `BODY`. The second moment M = ΛΛᵀ per unit mass, with
Λ = `MOMENT`·c_00·Y_00·(lower triangle of λ, exp on its diagonal), gives the inertia tr(M)1 − M.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

from palmd.model.compiled import Library, load
from palmd.model.kernels import Kernel, of_columns, single
from palmd.model.planar_friction import averaged_direction, direction_moments
from palmd.model.spherical import Y00, SphericalSurface, count, curvature, point
from palmd.model.symbolic import SX, ca
from palmd.system.vibration import VibrationLaw

MOMENT = 0.42
"""Scale of Λ for radius 1 and λ = 0: a shell has 0.577, a homogeneous sphere 0.447, a denser core less."""
BODY = 9
"""Number of parameters after the outline: λ (6, rows of the lower triangle), damping (m²/s), μ, ln u_d (ln m/s)."""
PALM_INPUTS = 36
"""Normals, their first and second derivatives, spins: 3 palms × 3 each, palm by palm."""
RIG_INPUTS = 2
"""Gravity (m/s²), and the ripple transmission λ of the palms' vibration."""

Vectors = list[SX]


@dataclass(frozen=True, slots=True)
class PalmVectors:
    """Normals of the palms, their first and second derivatives, and spins; columns."""

    normal: Vectors
    rate: Vectors
    acceleration: Vectors
    spin: Vectors

    @classmethod
    def of(cls, inputs: SX) -> PalmVectors:
        """Split a column of `PALM_INPUTS`."""
        kinds = [[inputs[9 * kind + 3 * i : 9 * kind + 3 * i + 3] for i in range(3)] for kind in range(4)]
        return cls(*kinds)

    @property
    def vibration_axes(self) -> Vectors:
        """Direction in which each palm vibrates: its pad's axis a, whose sense does not matter.

        Palm 1 vibrates along the edge about which it tilts, the others perpendicular to the axis about which they turn.
        """
        axle, two, three = self.normal
        return [SX([1, 0, 0]), ca.cross(axle, two), ca.cross(three, axle)]

    @property
    def inverse(self) -> SX:
        """N⁻¹; its columns are the reciprocal vectors of the normals."""
        one, two, three = self.normal
        volume = ca.dot(one, ca.cross(two, three))
        return ca.horzcat(ca.cross(two, three), ca.cross(three, one), ca.cross(one, two)) / volume


def _inverse(A: SX) -> SX:
    """Inverse of a 3 × 3 matrix."""
    rows = [A[i, :].T for i in range(3)]
    columns = [ca.cross(rows[1], rows[2]), ca.cross(rows[2], rows[0]), ca.cross(rows[0], rows[1])]
    return ca.horzcat(*columns) / ca.dot(rows[0], columns[0])


def _inertia(scale: SX, lam: SX) -> SX:
    """Inertia in the body's frame (m²) of a body of radius `scale`."""
    L = SX(3, 3)
    index = 0
    for i in range(3):
        for j in range(i + 1):
            L[i, j] = ca.exp(lam[index]) if i == j else lam[index]
            index += 1
    M = (MOMENT * scale) ** 2 * (L @ L.T)
    return ca.trace(M) * SX.eye(3) - M


def _newton_euler(
    palms: PalmVectors, r: Vectors, p_rate: SX, omega: SX, a: SX, J: SX, body: SX, rig: SX, law: VibrationLaw
) -> tuple[SX, SX]:
    """(ω̇, normal forces f per unit mass) for nᵢ·p̈ + (rᵢ×nᵢ)·ω̇ = aᵢ; body: damping, μ, ln u_d with u_d = πV/2.

    The palms vibrate independently, each along its `vibration_axes`. At slip uᵢ palm i exerts f (n − μ s), where
    s = σ + λμΣk, with σ and Σ of `planar_friction` and k the response of its own normal force to friction: the diagonal
    of A⁻¹B where A f = b + μ B s f. Exact to order μ². In the averaged law s = u/√(u² + u_d²).
    """
    damping, mu, speed = body[0], body[1], ca.exp(body[2]) * (2 / math.pi)
    p = palms.inverse @ ca.vertcat(*(-ca.dot(n, each) for n, each in zip(palms.normal, r, strict=True)))
    N = ca.horzcat(*palms.normal).T
    arms = ca.horzcat(*(ca.cross(each, n) for each, n in zip(r, palms.normal, strict=True))).T
    J_inverse = _inverse(J)
    turning = arms @ J_inverse
    A = N @ N.T + turning @ arms.T
    A_inverse = _inverse(A) if law == "sign_pairs" else None
    pushes, torques = [], []
    for i, (n, e, spin, each) in enumerate(zip(palms.normal, palms.vibration_axes, palms.spin, r, strict=True)):
        slip = p_rate + ca.cross(omega, each) - ca.cross(spin, p + each)
        axes = e, ca.cross(n, e)
        ratio = [ca.dot(axis, slip) / speed for axis in axes]
        if A_inverse is None:
            direction = averaged_direction(*ratio)
        else:
            (along, across), (first, mixed, second) = direction_moments(*ratio)
            response = A_inverse[i, :]
            k = [response @ (N @ axis + turning @ ca.cross(each, axis)) for axis in axes]
            ripple = rig[1] * mu
            direction = (
                along + ripple * (first * k[0] + mixed * k[1]),
                across + ripple * (mixed * k[0] + second * k[1]),
            )
        pushes.append(n - mu * (direction[0] * axes[0] + direction[1] * axes[1]))
        torques.append(ca.cross(each, pushes[-1]))
    F, T = ca.horzcat(*pushes), ca.horzcat(*torques)
    free = -damping * omega - ca.cross(omega, J @ omega)
    weight = ca.vertcat(0, 0, -rig[0])
    f = _inverse(N @ F + turning @ T) @ (a - N @ weight - turning @ free)
    return J_inverse @ (T @ f + free), f


def newton_function(law: VibrationLaw) -> ca.Function:
    """(R, ω, xᵢ, κᵢ, [radius, body], palms, rig) → (ω̇, f, and ω̇'s Jacobian in δ, ω, x, κ, [radius, body]).

    x: contacts in the body's frame, palm by palm; κᵢ = sᵢᵀR∇²H(uᵢ)Rᵀsᵢ, sᵢ = ω×nᵢ − ṅᵢ. The Jacobian treats x and κ as
    independent of δ and ω.
    """
    R, omega, x, kappa = SX.sym("R", 3, 3), SX.sym("omega", 3), SX.sym("x", 9), SX.sym("kappa", 3)
    body, inputs, rig = SX.sym("body", 1 + BODY), SX.sym("palms", PALM_INPUTS), SX.sym("rig", RIG_INPUTS)
    turn = SX.sym("turn", 3)
    palms = PalmVectors.of(inputs)
    turned = (SX.eye(3) + ca.skew(turn)) @ R
    r = [turned @ x[3 * i : 3 * i + 3] for i in range(3)]
    J = turned @ _inertia(body[0], body[1:7]) @ turned.T
    p = palms.inverse @ ca.vertcat(*(-ca.dot(n, each) for n, each in zip(palms.normal, r, strict=True)))
    s = [ca.cross(omega, n) - rate for n, rate in zip(palms.normal, palms.rate, strict=True)]
    p_rate = palms.inverse @ ca.vertcat(*(-ca.dot(palms.rate[i], p) + ca.dot(r[i], s[i]) for i in range(3)))
    a = ca.vertcat(
        *(
            -ca.dot(palms.acceleration[i], p)
            - 2 * ca.dot(palms.rate[i], p_rate)
            + kappa[i]
            + ca.dot(r[i], ca.cross(omega, palms.rate[i]) - palms.acceleration[i] - ca.cross(omega, s[i]))
            for i in range(3)
        )
    )
    alpha, f = _newton_euler(palms, r, p_rate, omega, a, J, body[7:], rig, law)
    by = ca.jacobian(alpha, ca.vertcat(turn, omega, x, kappa, body))
    outputs = [ca.substitute(each, turn, SX.zeros(3)) for each in (alpha, f, by)]
    return ca.Function("newton", [R, omega, x, kappa, body, inputs, rig], ca.cse(outputs))


def local_function(order: int) -> ca.Function:
    """(u, s, c) → (q = (x, κ), ∂q/∂u, ∂q/∂s, ∂q/∂c)."""
    u, s, c = SX.sym("u", 3), SX.sym("s", 3), SX.sym("c", count(order))
    surface = SphericalSurface(u, c, order)
    terms = surface.terms()
    x, x_by_u, x_rows = point(surface, terms)
    kappa, by_u, by_s, rows = curvature(surface, terms, s)
    outputs = [
        ca.vertcat(x, kappa),
        ca.vertcat(x_by_u, by_u),
        ca.vertcat(SX.zeros(3, 3), by_s),
        ca.vertcat(x_rows, rows),
    ]
    return ca.Function("local", [u, s, c], ca.cse([ca.densify(each) for each in outputs]))


def _point_function(order: int) -> ca.Function:
    """(u, c) → (x, ∂x/∂u, ∂h/∂c, ∂x/∂c)."""
    u, c = SX.sym("u", 3), SX.sym("c", count(order))
    surface = SphericalSurface(u, c, order)
    terms = surface.terms()
    x, by_u, rows = point(surface, terms)
    return ca.Function("point", [u, c], ca.cse([ca.densify(each) for each in (x, by_u, terms.S.T, rows)]))


def acceleration_function(order: int, law: VibrationLaw) -> ca.Function:
    """(R, ω, palms; p, rig) → (ω̇, f, ∂ω̇/∂δ, ∂ω̇/∂ω, ∂ω̇/∂p)."""
    n = count(order)
    R, omega, inputs = ca.MX.sym("R", 3, 3), ca.MX.sym("omega", 3), ca.MX.sym("palms", PALM_INPUTS)
    parameters, rig = ca.MX.sym("p", n + BODY), ca.MX.sym("rig", RIG_INPUTS)
    c, body = parameters[:n], ca.vertcat(Y00 * parameters[0], parameters[n:])
    local, newton = local_function(order), newton_function(law)
    q, by_turn, by_omega, by_c = [], [], [], []
    for i in range(3):
        normal, rate = inputs[3 * i : 3 * i + 3], inputs[9 + 3 * i : 12 + 3 * i]
        s = ca.cross(omega, normal) - rate
        value, by_u, by_s, rows = local(-R.T @ normal, R.T @ s, c)
        across = R.T @ ca.skew(normal)
        q.append(value)
        by_turn.append(-by_u @ across + by_s @ (R.T @ ca.skew(s)))
        by_omega.append(-by_s @ across)
        by_c.append(rows)
    x, kappa = ca.vertcat(*(each[:3] for each in q)), ca.vertcat(*(each[3] for each in q))
    alpha, f, by = newton(R, omega, x, kappa, body, inputs, rig)
    to_turn, to_omega, to_c, to_body = by[:, 0:3], by[:, 3:6], ca.MX.zeros(3, n), by[:, 18:]
    for i in range(3):
        through = ca.horzcat(by[:, 6 + 3 * i : 9 + 3 * i], by[:, 15 + i])
        to_turn += through @ by_turn[i]
        to_omega += through @ by_omega[i]
        to_c += through @ by_c[i]
    to_c = ca.horzcat(to_c[:, 0] + Y00 * to_body[:, 0], to_c[:, 1:])
    outputs = [alpha, f, to_turn, to_omega, ca.horzcat(to_c, to_body[:, 1:])]
    return ca.Function("acceleration", [R, omega, inputs, parameters, rig], [ca.densify(o) for o in outputs])


def reading_function(order: int) -> ca.Function:
    """(R, [n of the pad's palm and the two next, columns of N⁻¹ in this order, axes a, b]; c) → (y, ∂y/∂δ, ∂y/∂c).

    y = (a, b): the pad's reading eᵀ(p + R x(u)).
    """
    n = count(order)
    R, geometry, c = ca.MX.sym("R", 3, 3), ca.MX.sym("geometry", 24), ca.MX.sym("c", n)
    at = _point_function(order)
    axes = ca.horzcat(geometry[18:21], geometry[21:24])
    value, by_turn, by_c = ca.MX.zeros(2), ca.MX.zeros(2, 3), ca.MX.zeros(2, n)
    for i in range(3):
        normal, lift = geometry[3 * i : 3 * i + 3], axes.T @ geometry[9 + 3 * i : 12 + 3 * i]
        u, u_by_turn = -R.T @ normal, -R.T @ ca.skew(normal)
        x, by_u, height_rows, rows = at(u, c)
        value += lift * ca.dot(u, x)
        by_turn += lift @ (x.T @ u_by_turn)
        by_c += lift @ height_rows
        if i == 0:
            r, onto = R @ x, axes.T @ R
            value += axes.T @ r
            by_turn += onto @ by_u @ u_by_turn - axes.T @ ca.skew(r)
            by_c += onto @ rows
    return ca.Function("reading", [R, geometry, c], [ca.densify(o) for o in (value, by_turn, by_c)])


def driven_function(law: VibrationLaw) -> ca.Function:
    """([p, ω], palms, [cᵢ, ċᵢ]; [ln radius of gyration, damping, ln μ, ln u_d], rig) → (rates, ∂/∂state, ∂/∂constants).

    The same equations for a ball-like body, inertia ρ²·1, with given contacts and their velocities instead of a shape.
    rᵢ = cᵢ − p.
    """
    state, inputs, contacts = SX.sym("state", 6), SX.sym("palms", PALM_INPUTS), SX.sym("contacts", 18)
    constants, rig = SX.sym("constants", 4), SX.sym("rig", RIG_INPUTS)
    p, omega, palms = state[:3], state[3:], PalmVectors.of(inputs)
    points = [contacts[3 * i : 3 * i + 3] for i in range(3)]
    moving = [contacts[9 + 3 * i : 12 + 3 * i] for i in range(3)]
    r = [c - p for c in points]
    p_rate = palms.inverse @ ca.vertcat(
        *(-ca.dot(palms.rate[i], points[i]) - ca.dot(omega, ca.cross(r[i], palms.normal[i])) for i in range(3))
    )
    a = ca.vertcat(
        *(
            -ca.dot(palms.rate[i], p_rate + moving[i])
            - ca.dot(palms.acceleration[i], points[i])
            - ca.dot(omega, ca.cross(moving[i] - p_rate, palms.normal[i]) + ca.cross(r[i], palms.rate[i]))
            for i in range(3)
        )
    )
    J = ca.exp(2 * constants[0]) * SX.eye(3)
    body = ca.vertcat(constants[1], ca.exp(constants[2]), constants[3])
    alpha, _ = _newton_euler(palms, r, p_rate, omega, a, J, body, rig, law)
    rates = ca.vertcat(p_rate, alpha)
    outputs = ca.cse([rates, ca.jacobian(rates, state), ca.jacobian(rates, constants)])
    return ca.Function("driven", [state, inputs, contacts, constants, rig], outputs)


def _of_motion(function: ca.Function) -> ca.Function:
    """The same without its last output, the parameter Jacobian, for fits of the motion alone."""
    inputs, name = function.mx_in(), f"{function.name()}_of_motion"
    names = [function.name_in(i) for i in range(function.n_in())]
    return ca.Function(name, inputs, function.call(inputs)[:-1], names, function.name_out()[:-1])


def _over_block(function: ca.Function, shared: int) -> Kernel:
    """`function` for many instants side by side, which share the last `shared` inputs."""
    names = function.name_in()
    return of_columns(function, f"{function.name()}_block", names[len(names) - shared :])


@cache
def library(order: int, law: VibrationLaw = "sign_pairs") -> Library:
    """`acceleration_block` and `reading_block` for outlines up to degree `order`, and both `…_of_motion_block`."""

    def kernels() -> list[Kernel]:
        acceleration, reading = acceleration_function(order, law), reading_function(order)
        motion = _over_block(_of_motion(acceleration), 2), _over_block(_of_motion(reading), 1)
        return [_over_block(acceleration, 2), _over_block(reading, 1), *motion]

    return load(f"three_palms{order}{_SUFFIX[law]}", kernels)


@cache
def filter_library(order: int, law: VibrationLaw, written: str) -> Library:
    """`acceleration` and `reading` for one instant, and the functions of the C file `written` that call them."""
    return load(
        f"three_palms_filter{order}{_SUFFIX[law]}",
        lambda: [single(acceleration_function(order, law)), single(reading_function(order))],
        written=[written],
    )


@cache
def driven_library(law: VibrationLaw = "sign_pairs") -> Library:
    """`driven_block`."""
    return load(f"three_palms_driven{_SUFFIX[law]}", lambda: [_over_block(driven_function(law), 2)])


_SUFFIX: dict[VibrationLaw, str] = {"sign_pairs": "", "averaged": "_averaged"}
"""Suffix of a library's name for each law of friction."""
