"""Values and standard deviations of the named state from a set of quasistatic trajectories. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model import quasistatic as qs
from palmd.model.outputs import NAMED
from palmd.observer.mass import resting_forces
from palmd.observer.multi_start import MultiStart
from palmd.observer.prior import GYRATION, GYRATION_SD
from palmd.system.description import RigDescription
from palmd.system.mechanism import (
    CONTACTS,
    FORCES,
    JOINT_RATES,
    JOINTS,
    OPENING,
    RADII,
    directions,
    hinge_position,
)

# 1σ model errors of radii, ψ and ψ̇ about the best initial condition, from the emulated rig: friction and inertia are
# not in the model.
RADIUS_MODEL_SD_M, TURN_MODEL_SD_RAD, SPIN_MODEL_SD_RAD_S = 1.0e-3, 0.35, 0.5
FITTED = 0.6  # 1σ of a smoothed value at the end of the record, relative to a reading's
PALM_RATE_SD = 5e-3  # rad/s


@dataclass(frozen=True, slots=True)
class LeadingSet:
    """The leading set at its last node: mean and 1σ of r1, r2, ψ and ψ̇; errors and index of its likeliest member."""

    values: FloatArray
    sds: FloatArray
    e_f: float
    e_c: float
    conflict: float
    best: int


def summarise(leader: MultiStart, readings: qs.QuasistaticReadings, weights: FloatArray) -> LeadingSet:
    """Weighted statistics of the leading set at a node with these smoothed `readings`."""
    rates = qs.rates(readings, leader.state, leader.softening)
    each = np.concatenate([leader.state[:3], rates[2:3]])
    mean = each @ weights
    sd = np.sqrt(((each - mean[:, None]) ** 2) @ weights)
    best = int(np.argmax(weights))
    e_c = np.hypot(*qs.closure_error(readings, leader.state[:, best]))
    e_f = qs.balance_error(readings, *leader.state[:2, best].tolist())
    return LeadingSet(mean, sd, float(e_f), float(e_c), float(leader.conflict[best]), best)


def named(
    rig: RigDescription, node: qs.QuasistaticReadings, found: LeadingSet, now: qs.QuasistaticReadings, ahead: float
) -> tuple[FloatArray, FloatArray]:
    """Values and 1σ of `NAMED` at readings `now`, extrapolated by `ahead` (s) from the last `node` at its rates."""
    *node_radii, psi, omega0 = found.values.tolist()
    turning = directions(node.joint_rates)
    radii = [
        r - float(d * (rate - omega0)) * ahead  # (3.33), (3.34)
        for r, d, rate in zip(node_radii, qs.offsets(node, *node_radii), turning, strict=True)
    ]
    psi += omega0 * ahead
    radius_sd = np.hypot(found.sds[:2], RADIUS_MODEL_SD_M)
    mean, mean_sd = sum(radii) / 2, float(radius_sd.mean())
    rho = GYRATION * mean
    com_x, com_y = _centre(rig, [float(angle) for angle in now.joints], radii)
    values = {
        **dict(zip(RADII, radii, strict=True)), **dict(zip(CONTACTS, now.contacts, strict=True)),
        **dict(zip(JOINTS, now.joints, strict=True)), **dict(zip(JOINT_RATES, now.joint_rates, strict=True)),
        **dict(zip(FORCES, resting_forces(rig.gravity, np.array(now.joints)), strict=True)),
        "omega0": omega0, "rho": rho, "psi": psi, "com_x": com_x, "com_y": com_y,
    }  # fmt: skip
    sds = {
        **dict(zip(RADII, radius_sd, strict=True)),
        **{name: FITTED * math.sqrt(pad.reading_variance) for name, pad in zip(CONTACTS, rig.pads, strict=True)},
        **dict.fromkeys(JOINTS, FITTED * rig.palm_angle_noise), **dict.fromkeys(JOINT_RATES, PALM_RATE_SD),
        "omega0": math.hypot(found.sds[3], SPIN_MODEL_SD_RAD_S),
        "rho": math.hypot(GYRATION_SD * rho, GYRATION * mean_sd), "psi": math.hypot(found.sds[2], TURN_MODEL_SD_RAD),
    }  # fmt: skip
    y = np.array([values.get(name, math.nan) for name in NAMED])
    return y, np.array([sds.get(name, math.nan) for name in NAMED])


def _centre(rig: RigDescription, joints: Sequence[float], radii: Sequence[float]) -> tuple[float, float]:
    """The centre of mass (m, world frame) from n_i·c = r_i about the hinge, which is fixed or moves on an arc."""
    (first, second), (one, two) = directions(joints), radii
    x = (one * math.cos(second) + two * math.cos(first)) / math.sin(joints[OPENING])
    y = (one * math.sin(second) + two * math.sin(first)) / math.sin(joints[OPENING])
    hinge_x, hinge_y = hinge_position(*rig.arc, first)
    return x + hinge_x, y + hinge_y
