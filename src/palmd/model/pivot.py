"""Kernels of the pivoting grasp: the pad's reading, the pivot's height, the normal force, and the residual torque.

Each takes the body's motion (ψ, ω0, α0) at one instant and the constants p, and returns a value and its gradient in
(ψ, ω0, α0, p). About the pivot P the body has inertia I and mass moment M = m·(centre of mass − P), in the body's
frame; ξ is M in the world frame. The pad vibrates along itself with speed amplitude V: friction alternates, and the
normal force with it (docs/theory/vibration.md). At slip u each sign s of the sliding lasts for a share (1 ± σ)/2 of the
time, σ = (2/π) asin(u/V), so that the mean force is that of a constant direction σ + λ(E[s f]/E[f] − σ) of friction. In
the averaged law, for logs that were simulated with it, friction is B u/√(1 + w u²) and the normal force is steady.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from functools import cache

from palmd.model.compiled import Library, load
from palmd.model.friction import mean_direction
from palmd.model.kernels import Kernel, of_columns
from palmd.model.shape import contact_at
from palmd.model.symbolic import SX, ca
from palmd.system.vibration import VibrationLaw

ORDER = 10  # harmonics of the outline
MOTION = 3  # ψ, ω0, α0
KINK = 1e-2  # ε of `mean_direction`: a rolling body slips at nearly V, where friction determines its coefficient
BATCH = 64


class P(IntEnum):
    """Index of each constant; SI units. DRAG is B = μ/u_d (s/m), SATURATION w = 1/u_d² (s²/m²), u_d = πV/2.

    TRANSMISSION is λ, the ripple transmission: the share of friction's alternation that the normal force follows.

    The rig's constants are errors of its description: the pad reads ZERO + (1 + SCALE)·position with a delay LAG, its
    surface is STANDOFF too high at the arm's x = 0 and rises with SLOPE.
    """

    INERTIA = 0  # about P, kg m²
    MOMENT = 1  # 2: kg m
    DAMPING = 3  # N m s
    MASS = 4  # kg
    DRAG = 5
    SATURATION = 6
    ZERO = 7
    SCALE = 8
    LAG = 9
    STANDOFF = 10
    SLOPE = 11
    TRANSMISSION = 12
    SHAPE = 13


CONSTANTS = P.SHAPE + 2 * ORDER + 1


class U(IntEnum):
    """Index of each input: the arm's motion (z: rigid only), gravity, and the slide's mass and damping."""

    X = 0
    VX = 1
    AX = 2
    Z = 3
    VZ = 4
    AZ = 5
    GRAVITY = 6
    CARRIAGE = 7
    CARRIAGE_DAMPING = 8


INPUTS = len(U)


def _body(motion: SX, p: SX) -> tuple[SX, SX, SX, SX, SX]:
    """(h, h′, h″ about P at the contact, ξx, ξy)."""
    contact = contact_at(-0.5 * math.pi - motion[0], p[P.SHAPE :])
    cos, sin = ca.cos(motion[0]), ca.sin(motion[0])
    mx, my = p[P.MOMENT], p[P.MOMENT + 1]
    return contact.r, -contact.d, contact.v - contact.r, cos * mx - sin * my, sin * mx + cos * my


def _direction(motion: SX, p: SX, u: SX, h: SX, law: VibrationLaw) -> SX:
    """σ of the slip u = Ẋ + h ω0."""
    ratio = (u[U.VX] + h * motion[1]) * ca.sqrt(p[P.SATURATION])
    return mean_direction(math.pi / 2 * ratio, kink=KINK) if law == "sign_pairs" else ratio / ca.sqrt(1 + ratio**2)


def _effective(sigma: SX, forward: SX, backward: SX, p: SX, law: VibrationLaw) -> SX:
    """σ + λ(E[s f]/E[f] − σ), for forces in the ratio of `forward` to `backward` while the body slips so."""
    if law == "averaged":
        return sigma
    ahead, behind = (1 + sigma) * forward, (1 - sigma) * backward
    return sigma + p[P.TRANSMISSION] * ((ahead - behind) / (ahead + behind) - sigma)


def _friction(p: SX) -> SX:
    """μ."""
    return p[P.DRAG] / ca.sqrt(p[P.SATURATION])


def _resisting(motion: SX, p: SX, u: SX, az: SX, xi_x: SX, xi_y: SX) -> SX:
    """Torque about P that the pad must exert: I α0 + ξx (g + z̈) − ξy Ẍ + C ω0."""
    inertia = p[P.INERTIA] * motion[2] + p[P.DAMPING] * motion[1]
    return inertia + xi_x * (u[U.GRAVITY] + az) - xi_y * u[U.AX]


def _reading(motion: SX, p: SX, u: SX) -> SX:
    _, e, h2, _, _ = _body(motion, p)
    lag = p[P.LAG]
    return p[P.ZERO] + (1 + p[P.SCALE]) * (u[U.X] + e - lag * (u[U.VX] - h2 * motion[1]))


def _height(motion: SX, p: SX, u: SX) -> SX:
    return _body(motion, p)[0] + p[P.STANDOFF] + p[P.SLOPE] * u[U.X]


def _rigid_force(motion: SX, p: SX, u: SX, law: VibrationLaw) -> SX:
    """N/(e − μσz), N the torque about P; with λ = 1 it is N (e + σμz)/(e² − μ²z²), not defined for |e| ≤ μz."""
    h, e, _, xi_x, xi_y = _body(motion, p)
    mu = _friction(p)
    sigma = _effective(_direction(motion, p, u, h, law), e + mu * h, e - mu * h, p, law)
    return _resisting(motion, p, u, u[U.AZ], xi_x, xi_y) / (e - mu * sigma * h)


def _sliding(motion: SX, p: SX, u: SX, law: VibrationLaw) -> tuple[SX, SX]:
    """(force, residual torque) under a slide that rests on the body by its weight."""
    h, e, h2, xi_x, xi_y = _body(motion, p)
    mu, alpha = _friction(p), SX.sym("alpha")

    def at(alpha0: SX, direction: SX) -> tuple[SX, SX]:
        turning = ca.vertcat(motion[:2], alpha0)
        vz, az = -e * motion[1], -e * alpha0 + h2 * motion[1] ** 2
        weight = (p[P.MASS] + u[U.CARRIAGE]) * (az + u[U.GRAVITY])
        force = weight + u[U.CARRIAGE_DAMPING] * vz + xi_x * alpha0 - xi_y * motion[1] ** 2
        return force, force * (e - mu * direction * h) - _resisting(turning, p, u, az, xi_x, xi_y)

    forces = []  # slipping forward and backward, at the α0 with zero residual torque
    for sign in (1, -1):
        left = at(alpha, SX(sign))[1]
        still = ca.substitute(left, alpha, 0)
        forces.append(at(-still / ca.jacobian(left, alpha), SX(sign))[0])
    return at(motion[2], _effective(_direction(motion, p, u, h, law), forces[0], forces[1], p, law))


@cache
def library(law: VibrationLaw = "sign_pairs") -> Library:
    """Kernels reading, height, rigid_force, slide_force and slide_torque, as `NAME_batch`; loaded once per process."""
    return load("pivot" if law == "sign_pairs" else "pivot_averaged", lambda: _kernels(law))


def needed(_config: object) -> list[tuple[str, Callable[[], str]]]:
    """Compiled parts for a pivoting grasp, the same for every configuration; see `palmd.observer.kernels.needed`."""
    return [("pivoting grasp", lambda: library().backend)]


def _kernels(law: VibrationLaw) -> list[Kernel]:
    motion, p, u = SX.sym("motion", MOTION), SX.sym("p", CONSTANTS), SX.sym("u", INPUTS)
    force, torque = _sliding(motion, p, u, law)
    values = {
        "reading": _reading(motion, p, u),
        "height": _height(motion, p, u),
        "rigid_force": _rigid_force(motion, p, u, law),
        "slide_force": force,
        "slide_torque": torque,
    }
    y = ca.vertcat(motion, p)
    kernels = []
    for name, value in values.items():
        one = ca.Function(name, [motion, p, u], [value, ca.jacobian(value, y)], ["motion", "p", "u"], [name, "J"])
        kernels.append(of_columns(one, f"{name}_batch", ["p"]))
    return kernels
