"""Accelerations and contact forces of bodies on three palms in NumPy, independent of `rig/three_palms/plant.c`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.rig.three_palms.bodies import Bodies
from palmd.rig.three_palms.plant import PHASES, FrictionParameters

GAP_RATE = 100.0
"""κ (1/s), decay rate of the gap errors."""
KINK = 0.03
"""Share of the vibration's speed below which friction falls in proportion to slip."""


@dataclass(frozen=True, slots=True)
class PalmState:
    """The palms of every body at one instant, (B, 3 palms, 3): normals, their derivatives, spins."""

    normal: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    spin: FloatArray


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
    """(v̇ (B, 3), ω̇ (B, 3), contacts): means over vibration phases (N, 3 palms) (rad)."""
    n, R, w = palms.normal, state.R, state.omega[:, None]
    u = -np.einsum("bji,bnj->bni", R, n)
    h, x, bend = bodies.support(u)
    r = np.einsum("bij,bnj->bni", R, x)
    c = state.p[:, None] + r
    turning = palms.rate - np.cross(w, n)  # of the normal relative to the body, in world axes
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
    """(B, 3 palms, 3) vibration axes of palms with these normals: the pads' axes a up to sign."""
    axes = np.cross(normal[:, :1], normal)
    axes[:, 0] = 1.0, 0.0, 0.0
    return axes


def _friction_directions(slip: FloatArray, speed: FloatArray, phases: FloatArray) -> FloatArray:
    """(B, N, 3 palms, 2) directions of friction at phases (N, 3) for slips (B, 3 palms, 2), along and across."""
    slips = np.repeat(slip[:, None], len(phases), axis=1)
    slips[..., 0] += speed[:, None, None] * np.cos(phases)
    directions: FloatArray = slips / np.sqrt((slips**2).sum(-1) + (KINK * speed[:, None, None]) ** 2)[..., None]
    return directions
