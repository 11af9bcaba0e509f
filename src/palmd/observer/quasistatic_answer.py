"""From a set of quasistatic trajectories to values and one-sigmas of the named state. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model import quasistatic as qs
from palmd.model.outputs import NAMED
from palmd.observer.mass import resting_forces
from palmd.observer.multi_start import MultiStart
from palmd.observer.prior import GYRATION, GYRATION_SD
from palmd.system.description import RigDescription
from palmd.system.mechanism import hinge_position

# What remains about the best initial condition, from the emulated rig: friction and inertia are not in the model.
RADIUS_OFF_M, TURN_OFF_RAD, SPIN_OFF_RAD_S = 1.0e-3, 0.35, 0.5
FITTED = 0.6  # of a reading's one-sigma that is left in the smoothed value at the end of the record
PALM_RATE_SD = 5e-3  # rad/s


@dataclass(frozen=True, slots=True)
class Leading:
    """A set at its last node: mean and one-sigma of r1, r2, ψ and ψ̇; errors and number of its likeliest member."""

    values: FloatArray
    sds: FloatArray
    e_f: float
    e_c: float
    conflict: float
    best: int


def read_off(leader: MultiStart, felt: qs.QuasistaticReadings, weights: FloatArray) -> Leading:
    """The leading set, of which each initial condition has its weight, where this is `felt`."""
    rates = qs.rates(felt, leader.state, leader.softening)
    each = np.concatenate([leader.state[:3], rates[2:3]])
    mean = each @ weights
    sd = np.sqrt(((each - mean[:, None]) ** 2) @ weights)
    best = int(np.argmax(weights))
    r1, r2 = leader.state[:2, best].tolist()
    e_c = np.hypot(*qs.closure_error(felt, leader.state[:, best]))
    e_f = qs.balance_error(felt, r1, r2)
    return Leading(mean, sd, float(e_f), float(e_c), float(leader.conflict[best]), best)


def named(
    rig: RigDescription, node: qs.QuasistaticReadings, found: Leading, now: qs.QuasistaticReadings, ahead: float
) -> tuple[FloatArray, FloatArray]:
    """Values and one-sigmas of `NAMED` when `now` is felt, `ahead` s after the last `node`, at that node's rates."""
    r1, r2, psi, omega0 = found.values.tolist()
    d1, d2 = qs.offsets(node, r1, r2)
    r1 -= float(d1 * (node.omega1 - omega0)) * ahead  # (3.33)
    r2 -= float(d2 * (node.omega12 - omega0)) * ahead  # (3.34)
    psi += omega0 * ahead
    radius_sd = np.hypot(found.sds[:2], RADIUS_OFF_M)
    mean, mean_sd = (r1 + r2) / 2, float(radius_sd.mean())
    rho = GYRATION * mean
    f1, f2 = resting_forces(rig.gravity, np.array([now.phi1, now.phi2]))
    com_x, com_y = _centre(rig, float(now.phi1), float(now.phi2), r1, r2)
    s1_sd, s2_sd = (FITTED * math.sqrt(pad.reading_variance) for pad in rig.pads)
    phi_sd = FITTED * rig.palm_angle_noise
    values = {
        "r1": r1, "r2": r2, "omega0": omega0, "s1": now.s1, "s2": now.s2,
        "phi1": now.phi1, "omega1": now.omega1, "phi2": now.phi2, "omega2": now.omega2,
        "rho": rho, "psi": psi, "f1": f1, "f2": f2, "com_x": com_x, "com_y": com_y,
    }  # fmt: skip
    sds = {
        "r1": radius_sd[0], "r2": radius_sd[1], "omega0": math.hypot(found.sds[3], SPIN_OFF_RAD_S),
        "s1": s1_sd, "s2": s2_sd, "phi1": phi_sd, "omega1": PALM_RATE_SD, "phi2": phi_sd, "omega2": PALM_RATE_SD,
        "rho": math.hypot(GYRATION_SD * rho, GYRATION * mean_sd), "psi": math.hypot(found.sds[2], TURN_OFF_RAD),
    }  # fmt: skip
    y = np.array([values.get(name, math.nan) for name in NAMED])
    return y, np.array([sds.get(name, math.nan) for name in NAMED])


def _centre(rig: RigDescription, phi1: float, phi2: float, r1: float, r2: float) -> tuple[float, float]:
    """The centre of mass (m, world frame): n1·c = r1, n2·c = r2 from the hinge, itself on an arc or fixed."""
    phi12 = phi1 + phi2
    x = (r1 * math.cos(phi12) + r2 * math.cos(phi1)) / math.sin(phi2)
    y = (r1 * math.sin(phi12) + r2 * math.sin(phi1)) / math.sin(phi2)
    hinge_x, hinge_y = hinge_position(*rig.arc, phi1)
    return x + hinge_x, y + hinge_y
