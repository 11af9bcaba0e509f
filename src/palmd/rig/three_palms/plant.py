"""Free rigid bodies in contact with three palms by constraint forces: B bodies with all six degrees of freedom each.

State of each: position, velocity, rotation, spin. The gaps gᵢ = nᵢ·p − h(−Rᵀnᵢ) are kept at zero by normal forces that
make g̈ᵢ = −2κġᵢ − κ²gᵢ, so that integration errors decay. Friction is dry. The palms vibrate, each along its pad's axis
a and independently of the others: at every instant friction is Coulomb's along the slip of that instant, and the
contacts are rigid. The body is moved by the mean over `PHASES`, instants that are evenly spread over all combinations
of the three palms' phases and shifted at each step; or the vibrations are resolved in time (`vibrate`), as on a real
rig.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.rig.three_palms.bodies import Bodies

GAP_RATE = 100.0
"""κ (1/s), rate at which errors of the gaps decay."""
KINK = 0.03
"""Of the vibration's speed: slower slip has proportionally less friction, so that a step can resolve a reversal."""
INSTANTS = 64
PHASES: FloatArray = 2.0 * math.pi * (np.outer(np.arange(INSTANTS), (1, 19, 27)) / INSTANTS % 1.0)
"""(INSTANTS, 3 palms), rad: a lattice in which each palm's phases, and all pairs of two palms, are evenly spread."""
PHASE_SHIFT: FloatArray = 2.0 * math.pi * np.array([0.8191725134, 0.6710436067, 0.5497004779])
"""Shift of the lattice per step (rad): powers of 1/1.2207…, of which no integer combination is an integer."""

Motion = Callable[[float], "PalmState"]


@dataclass(frozen=True, slots=True)
class PalmState:
    """The palms of every body at one instant, (B, 3 palms, 3): normals, their derivatives, spins."""

    normal: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    spin: FloatArray


@dataclass(frozen=True, slots=True)
class FrictionParameters:
    """Friction coefficient mu, dither (m/s), drag of spin (m²/s, per unit mass); (B,) each.

    dither: πV/2, V the amplitude of the palms' vibration speed.
    """

    mu: FloatArray
    dither: FloatArray
    drag: FloatArray


@dataclass(frozen=True, slots=True)
class BodyStates:
    """Position (B, 3), velocity (B, 3), rotation to the world (B, 3, 3), spin (B, 3)."""

    p: FloatArray
    v: FloatArray
    R: FloatArray
    omega: FloatArray


@dataclass(frozen=True, slots=True)
class PalmContacts:
    """Contacts (B, 3 palms, 3) (m, world) and their normal forces (B, 3) per unit mass (m/s²)."""

    point: FloatArray
    force: FloatArray


def accelerations(
    bodies: Bodies,
    friction: FrictionParameters,
    palms: PalmState,
    state: BodyStates,
    gravity: float,
    phases: FloatArray = PHASES,
) -> tuple[FloatArray, FloatArray, PalmContacts]:
    """(v̇ (B, 3), ω̇ (B, 3), contacts): means over these phases (N, 3 palms) (rad) of the vibrations."""
    n, R, w = palms.normal, state.R, state.omega[:, None]
    u = -np.einsum("bji,bnj->bni", R, n)
    h, x, bend = bodies.support(u)
    r = np.einsum("bij,bnj->bni", R, x)
    c = state.p[:, None] + r
    turning = palms.rate - np.cross(w, n)  # of the normal, relative to the body, in world axes
    u_rate = -np.einsum("bji,bnj->bni", R, turning)
    sliding = np.cross(w, r) + np.einsum("bij,bnjk,bnk->bni", R, bend, u_rate)

    gap = np.einsum("bni,bi->bn", n, state.p) - h
    gap_rate = np.einsum("bni,bi->bn", n, state.v) + np.einsum("bni,bi->bn", palms.rate, state.p)
    gap_rate += (r * turning).sum(-1)
    bias = 2 * np.einsum("bni,bi->bn", palms.rate, state.v) + np.einsum("bni,bi->bn", palms.acceleration, state.p)
    bias += (sliding * turning).sum(-1) + (r * (palms.acceleration - np.cross(w, palms.rate))).sum(-1)

    slip = state.v[:, None] + np.cross(w, r) - np.cross(palms.spin, c)
    axes = vibration_axes(n)
    force_axes = np.stack([n, axes, np.cross(n, axes)], axis=2)  # (B, palms, 3 directions of force, 3)
    directions = _friction_directions(
        (force_axes[:, :, 1:] * slip[:, :, None]).sum(-1), 2 / math.pi * friction.dither, phases
    )
    J = np.einsum("bij,bjk,blk->bil", R, bodies.inertia, R)
    J_inverse = np.linalg.inv(J)
    jacobian = np.concatenate([n, np.cross(r, n)], axis=-1)  # ġ = jacobian·(v, ω) + …
    torque = np.cross(r[:, :, None], force_axes)
    wrench = np.concatenate([force_axes, np.einsum("bij,bnwj->bnwi", J_inverse, torque)], axis=-1)
    free = -friction.drag[:, None] * state.omega - np.cross(state.omega, np.einsum("bij,bj->bi", J, state.omega))
    free = np.concatenate(
        [np.tile([0.0, 0.0, -gravity], (len(h), 1)), np.einsum("bij,bj->bi", J_inverse, free)], axis=-1
    )
    wanted = -bias - 2 * GAP_RATE * gap_rate - GAP_RATE**2 * gap - np.einsum("bni,bi->bn", jacobian, free)
    unit_forces = np.concatenate(
        [np.ones_like(directions[..., :1]), -friction.mu[:, None, None, None] * directions], axis=-1
    )
    gap_response = np.einsum("bni,bmwi,bkmw->bknm", jacobian, wrench, unit_forces)
    force = np.linalg.solve(gap_response, wanted[:, None, :, None])[..., 0]
    total = free + np.einsum("bkm,bkmw,bmwi->bi", force, unit_forces, wrench) / len(phases)
    return total[:, :3], total[:, 3:], PalmContacts(c, force.mean(axis=1))


def vibration_axes(normal: FloatArray) -> FloatArray:
    """(B, 3 palms, 3) axes along which palms of these normals vibrate: the pads' axes a, except for their sign."""
    axes = np.cross(normal[:, :1], normal)
    axes[:, 0] = 1.0, 0.0, 0.0
    return axes


def _friction_directions(slip: FloatArray, speed: FloatArray, phases: FloatArray) -> FloatArray:
    """(B, N, 3 palms, 2) directions of friction at phases (N, 3) for slips (B, 3 palms, 2), along and across."""
    slips = np.repeat(slip[:, None], len(phases), axis=1)
    slips[..., 0] += speed[:, None, None] * np.cos(phases)
    directions: FloatArray = slips / np.sqrt((slips**2).sum(-1) + (KINK * speed[:, None, None]) ** 2)[..., None]
    return directions


def step(
    bodies: Bodies,
    friction: FrictionParameters,
    motion: Motion,
    state: BodyStates,
    dt: float,
    gravity: float,
    phases: FloatArray,
) -> BodyStates:
    """One step of the classical Runge–Kutta method, averaged over these phases (N, 3 palms) (rad)."""

    def rates(at: BodyStates, palms: PalmState) -> BodyStates:
        return _rates(bodies, friction, palms, at, gravity, phases)[0]

    halfway, ending = motion(dt / 2), motion(dt)
    k1 = rates(state, motion(0.0))
    k2 = rates(_moved(state, k1, 0.5 * dt), halfway)
    k3 = rates(_moved(state, k2, 0.5 * dt), halfway)
    k4 = rates(_moved(state, k3, dt), ending)
    mean = BodyStates(
        *((getattr(k1, k) + 2 * getattr(k2, k) + 2 * getattr(k3, k) + getattr(k4, k)) / 6 for k in _PARTS)
    )
    return _orthonormalised(_moved(state, mean, dt))


def vibrate(
    bodies: Bodies, friction: FrictionParameters, motion: Motion, state: BodyStates, phase: FloatArray,
    rate: FloatArray, count: int, dt: float, gravity: float,
) -> tuple[BodyStates, FloatArray, list[PalmContacts]]:  # fmt: skip
    """(state, phases (3,), contacts of each step) after `count` midpoint steps with resolved vibrations.

    rate: of the phases (rad/s).
    """
    h, touches = dt / count, []
    for n in range(count):
        by, _ = _rates(bodies, friction, motion(n * h), state, gravity, phase[None])
        middle, halfway = _moved(state, by, 0.5 * h), phase + 0.5 * h * rate
        by, touch = _rates(bodies, friction, motion((n + 0.5) * h), middle, gravity, halfway[None])
        state, phase = _moved(state, by, h), np.fmod(phase + h * rate, 2.0 * math.pi)
        touches.append(touch)
    return _orthonormalised(state), phase, touches


def _rates(
    bodies: Bodies, friction: FrictionParameters, palms: PalmState, at: BodyStates, gravity: float, phases: FloatArray
) -> tuple[BodyStates, PalmContacts]:
    v_rate, w_rate, touch = accelerations(bodies, friction, palms, at, gravity, phases)
    turning = np.cross(at.omega[:, None, :], np.swapaxes(at.R, 1, 2))
    return BodyStates(at.v, v_rate, np.swapaxes(turning, 1, 2), w_rate), touch


def _moved(state: BodyStates, by: BodyStates, dt: float) -> BodyStates:
    return BodyStates(*(getattr(state, k) + dt * getattr(by, k) for k in _PARTS))


def _orthonormalised(state: BodyStates) -> BodyStates:
    """The states after one Newton step towards the nearest rotation."""
    R = state.R @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(state.R, 1, 2) @ state.R)
    return BodyStates(state.p, state.v, R, state.omega)


_PARTS = ("p", "v", "R", "omega")
