"""Free rigid bodies held on three palms by constraint forces: B of them side by side, all six degrees of freedom each.

State of each: position, velocity, rotation, spin. The gaps gᵢ = nᵢ·p − h(−Rᵀnᵢ) are held at zero by normal forces that
make g̈ᵢ = −2κġᵢ − κ²gᵢ, so that what the integration lets in dies away. Friction is dry, hidden by the palms' dither.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.rig.three_palms.bodies import Bodies

PULL = 100.0
"""κ (1/s), of what holds the gaps at zero."""

Motion = Callable[[float], "PalmState"]


@dataclass(frozen=True, slots=True)
class PalmState:
    """The palms of every body at one instant, (B, 3 palms, 3): normals, their derivatives, spins."""

    normal: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    spin: FloatArray


@dataclass(frozen=True, slots=True)
class Rubbing:
    """What resists: friction coefficient mu, dither speed (m/s), drag of spin (m²/s, per unit mass); (B,) each."""

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
    bodies: Bodies, rubbing: Rubbing, palms: PalmState, state: BodyStates, gravity: float
) -> tuple[FloatArray, FloatArray, PalmContacts]:
    """(v̇ (B, 3), ω̇ (B, 3), contacts)."""
    n, R, w = palms.normal, state.R, state.omega[:, None]
    u = -np.einsum("bji,bnj->bni", R, n)
    h, x, bend = bodies.support(u)
    r = np.einsum("bij,bnj->bni", R, x)
    c = state.p[:, None] + r
    turning = palms.rate - np.cross(w, n)  # of the normal, as the body sees it, in world axes
    u_rate = -np.einsum("bji,bnj->bni", R, turning)
    sliding = np.cross(w, r) + np.einsum("bij,bnjk,bnk->bni", R, bend, u_rate)

    gap = np.einsum("bni,bi->bn", n, state.p) - h
    gap_rate = np.einsum("bni,bi->bn", n, state.v) + np.einsum("bni,bi->bn", palms.rate, state.p)
    gap_rate += (r * turning).sum(-1)
    bias = 2 * np.einsum("bni,bi->bn", palms.rate, state.v) + np.einsum("bni,bi->bn", palms.acceleration, state.p)
    bias += (sliding * turning).sum(-1) + (r * (palms.acceleration - np.cross(w, palms.rate))).sum(-1)

    slip = state.v[:, None] + np.cross(w, r) - np.cross(palms.spin, c)
    slip -= n * (slip * n).sum(-1)[..., None]
    drive = rubbing.mu[:, None] / np.sqrt((slip**2).sum(-1) + rubbing.dither[:, None] ** 2)
    push = n - drive[..., None] * slip
    J = np.einsum("bij,bjk,blk->bil", R, bodies.inertia, R)
    J_inverse = np.linalg.inv(J)
    jacobian = np.concatenate([n, np.cross(r, n)], axis=-1)  # ġ = jacobian·(v, ω) + …
    torque = np.cross(r, push)
    wrench = np.concatenate([push, np.einsum("bij,bnj->bni", J_inverse, torque)], axis=-1)
    free = -rubbing.drag[:, None] * state.omega - np.cross(state.omega, np.einsum("bij,bj->bi", J, state.omega))
    free = np.concatenate(
        [np.tile([0.0, 0.0, -gravity], (len(h), 1)), np.einsum("bij,bj->bi", J_inverse, free)], axis=-1
    )
    wanted = -bias - 2 * PULL * gap_rate - PULL**2 * gap - np.einsum("bni,bi->bn", jacobian, free)
    force = np.linalg.solve(np.einsum("bni,bmi->bnm", jacobian, wrench), wanted[..., None])[..., 0]
    total = free + np.einsum("bn,bni->bi", force, wrench)
    return total[:, :3], total[:, 3:], PalmContacts(c, force)


def step(
    bodies: Bodies, rubbing: Rubbing, motion: Motion, state: BodyStates, t: float, dt: float, gravity: float
) -> tuple[BodyStates, PalmContacts]:
    """(state after one step of the classical Runge–Kutta method, contacts at its beginning)."""

    def rates(at: BodyStates, palms: PalmState) -> tuple[BodyStates, PalmContacts]:
        v_rate, w_rate, touch = accelerations(bodies, rubbing, palms, at, gravity)
        turning = np.cross(at.omega[:, None, :], np.swapaxes(at.R, 1, 2))
        return BodyStates(at.v, v_rate, np.swapaxes(turning, 1, 2), w_rate), touch

    def moved(by: BodyStates, share: float) -> BodyStates:
        return BodyStates(*(getattr(state, k) + share * dt * getattr(by, k) for k in ("p", "v", "R", "omega")))

    halfway, ending = motion(t + dt / 2), motion(t + dt)
    k1, touch = rates(state, motion(t))
    k2, _ = rates(moved(k1, 0.5), halfway)
    k3, _ = rates(moved(k2, 0.5), halfway)
    k4, _ = rates(moved(k3, 1.0), ending)
    names = ("p", "v", "R", "omega")
    mean = BodyStates(*((getattr(k1, k) + 2 * getattr(k2, k) + 2 * getattr(k3, k) + getattr(k4, k)) / 6 for k in names))
    after = moved(mean, 1.0)
    # one step of Newton's towards the nearest rotation
    R = after.R @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(after.R, 1, 2) @ after.R)
    return BodyStates(after.p, after.v, R, after.omega), touch
