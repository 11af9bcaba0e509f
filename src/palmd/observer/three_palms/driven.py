"""The blind start: motion of a ball-like body for which the contacts are where they were read.

Given the contacts and their velocities, the equations of motion determine how centre of mass and spin evolve without
knowledge of the shape; the assumption of an approximately round body keeps both bounded. Neither rotation nor shape
occurs, so that there are hardly any local minima. Rotation follows by integration, shape by linear least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PPoly
from scipy.linalg import solveh_banded

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.observer.three_palms import kernels
from palmd.observer.three_palms.arrow import Arrow
from palmd.observer.three_palms.kernels import palm_inputs
from palmd.observer.three_palms.path import JointPath
from palmd.observer.three_palms.record import PadReadings
from palmd.system.three_palms import PALMS, ThreePalmsRig, contact_points

ROUNDNESS_SD_M = 8e-3
"""1σ of a contact's distance from that of a ball (m)."""
ROUNDNESS_TIME_S = 1.0
"""Correlation time of that distance."""
VELOCITY_DRIFT = 1e-8
"""Noise density of ṗ as computed from smoothed contacts (m²/s); that of ω̇ is part of a `BallBelief`."""
PENALTIES = 10.0 ** np.arange(-8.0, -2.0)
"""Candidate penalties of ∫f″² for smoothed contacts (s³); the one that predicts best is taken."""
SCORED_READINGS = 600  # readings; the part of a record by which penalties are compared
ITERATIONS = 25


@dataclass(frozen=True, slots=True)
class ContactCurves:
    """Smoothed readings: a(t) and b(t) of each pad (m)."""

    curves: tuple[tuple[PPoly, PPoly], ...]

    @classmethod
    def smoothed(cls, readings: PadReadings) -> ContactCurves:
        """Fit smoothing splines; the penalty of each coordinate is chosen by cross-validation."""
        curves = []
        for pad in range(len(PALMS)):
            mine = readings.pad == pad
            t, first = np.unique(readings.t[mine], return_index=True)
            value = readings.value[mine][first]
            curves.append((_smooth(t, value[:, 0]), _smooth(t, value[:, 1])))
        return cls(tuple(curves))

    def at(self, path: JointPath, t: FloatArray) -> FloatArray:
        """(T, 18) contact points (m, world) and their velocities, palm by palm."""
        palms = path.palms(t)
        a, b, a_rate, b_rate = (
            np.stack([pair[k].derivative(n)(t) for pair in self.curves], axis=1) for n in (0, 1) for k in (0, 1)
        )
        points = contact_points(palms, a, b)
        moving = np.cross(palms.spin, points) + contact_points(palms, a_rate, b_rate)
        return np.concatenate([points.reshape(-1, 9), moving.reshape(-1, 9)], axis=1)


def _smooth(t: FloatArray, value: FloatArray) -> PPoly:
    """Smoothing spline with the best penalty, which is chosen on the middle of a long record."""
    most = min(len(t), SCORED_READINGS)
    first = (len(t) - most) // 2
    part = slice(first, first + most)
    scores = [(_prediction_error(t[part], value[part], lam), lam) for lam in PENALTIES]
    return smoothing_spline(t, value, min(scores)[1])


def _prediction_error(t: FloatArray, value: FloatArray, lam: float) -> float:
    """Squared error with which one half of the values predicts the other."""
    odd = smoothing_spline(t[::2], value[::2], lam)
    even = smoothing_spline(t[1::2], value[1::2], lam)
    return float(((odd(t[1:-1:2]) - value[1:-1:2]) ** 2).sum() + ((even(t[2::2]) - value[2::2]) ** 2).sum())


def smoothing_spline(t: FloatArray, y: FloatArray, lam: float) -> PPoly:
    """Natural cubic spline f that minimises Σ(f(tᵢ) − yᵢ)² + lam ∫f″² (Reinsch 1967); t (T,) increasing, y (T,).

    (R + lam QᵀQ)γ = Qᵀy, f = y − lam Qγ at the knots, γ the second derivatives at the inner knots. SciPy's
    `make_smoothing_spline` computes the same, but spends most of its time in Python.
    """
    h = np.diff(t)
    before, after = 1.0 / h[:-1], 1.0 / h[1:]
    at = -before - after
    band = np.zeros((3, len(h) - 1))  # lower form: band[i − j, j]
    band[0] = (h[:-1] + h[1:]) / 3 + lam * (before**2 + at**2 + after**2)
    band[1, :-1] = h[1:-1] / 6 + lam * (at[:-1] * after[:-1] + before[1:] * at[1:])
    band[2, :-2] = lam * after[:-2] * before[2:]
    bends = np.zeros(len(t))
    bends[1:-1] = solveh_banded(band, np.diff(np.diff(y) / h), lower=True, check_finite=False)
    moments = np.diff(bends) / h
    f = y - lam * np.diff(moments, prepend=0.0, append=0.0)
    slope = np.diff(f) / h - h * (2 * bends[:-1] + bends[1:]) / 6
    return PPoly(np.stack([moments / 6, bends[:-1] / 2, slope, f[:-1]]), t)


@dataclass(frozen=True, slots=True)
class BallBelief:
    """Prior of a ball-like body: mean and 1σ of its constants, and of its state at the first node.

    Constants: ln ρ (ρ the radius of gyration, m), damping (m²/s), ln μ, ln u_d (ln m/s) and the radius (m). State:
    centre of mass (m) and spin (rad/s). rest_nodes: number of first nodes to which the spin of the state applies.
    drift: noise density of ω̇ as computed from smoothed contacts ((rad/s)²/s).
    """

    mean: FloatArray
    sd: FloatArray
    state: FloatArray
    state_sd: FloatArray
    rest_nodes: int = 1
    drift: float = 1.0


@dataclass(frozen=True, slots=True)
class DrivenCourse:
    """Centre of mass (K + 1, 3) (m) and spin (K + 1, 3) (rad/s) at the nodes t, the constants, and the cost."""

    t: FloatArray
    p: FloatArray
    omega: FloatArray
    constants: FloatArray
    cost: float

    def rotations(self, first: FloatArray | None = None) -> FloatArray:
        """(K + 1, 3, 3) rotations by integrating the spin from `first` (default: 1) at the first node."""
        h = np.diff(self.t)[:, None]
        one, other = self.omega[:-1], self.omega[1:]
        steps = rotation.exp(0.5 * h * (one + other) + h**2 / 12 * np.cross(other, one))
        R = [np.eye(3) if first is None else first]
        for step in steps:
            R.append(step @ R[-1])
        return np.stack(R)


def nearest_balls(points: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(centres (T, 3), radii (T,)) of the balls nearest to contacts (T, 3 palms, 3) on palms with these normals."""
    # c_i = p − r n_i, least squares in (p, r)
    mean_c, mean_n = points.mean(1), normals.mean(1)
    centred_points, centred_normals = points - mean_c[:, None], normals - mean_n[:, None]
    r = -(centred_points * centred_normals).sum((1, 2)) / (centred_normals**2).sum((1, 2))
    return mean_c + r[:, None] * mean_n, r


def smooth_course(
    path: JointPath,
    contacts: ContactCurves,
    start: float,
    intervals: int,
    spacing: float,
    belief: BallBelief,
    rig: ThreePalmsRig,
) -> DrivenCourse:
    """Smooth the motion over `intervals` from `start` (s): the maximum a posteriori."""
    t: FloatArray = np.asarray(start + spacing * np.arange(intervals + 1), dtype=np.float64)
    middle: FloatArray = np.asarray(t[:-1] + spacing / 2, dtype=np.float64)
    palms = path.palms(t)
    contacts_at_nodes, contacts_midway = contacts.at(path, t), contacts.at(path, middle)
    inputs, inputs_mid = palm_inputs(palms), palm_inputs(path.palms(middle))
    centres, _ = nearest_balls(contacts_at_nodes[:, :9].reshape(-1, 3, 3), palms.normal)
    problem = _Problem(inputs, inputs_mid, contacts_at_nodes, contacts_midway, palms.normal, spacing, belief, rig)
    state = np.concatenate([centres, np.zeros_like(centres)], axis=1)
    state[0] = belief.state
    constants = belief.mean.copy()
    cost, arrow = problem.evaluate(state, constants)
    damping = 1e-3
    for _ in range(ITERATIONS):
        nodes, step = arrow.solve(damping)
        trial = problem.evaluate(state + nodes, constants + step)
        if trial[0] < cost:
            gained, (cost, arrow) = cost - trial[0], trial
            state, constants = state + nodes, constants + step
            damping = max(damping / 5, 1e-9)
            if gained < 1e-3 * cost:
                break
        else:
            damping *= 8
            if damping > 1e6:
                break
    return DrivenCourse(t, state[:, :3], state[:, 3:], constants, cost)


@dataclass(frozen=True, slots=True)
class _Problem:
    """Least-squares problem in centre and spin at the nodes, and constants."""

    inputs: FloatArray
    inputs_mid: FloatArray
    contacts: FloatArray
    contacts_mid: FloatArray
    normals: FloatArray
    spacing: float
    belief: BallBelief
    rig: ThreePalmsRig

    def evaluate(self, state: FloatArray, constants: FloatArray) -> tuple[float, Arrow]:
        h, K, kernel = self.spacing, len(state) - 1, kernels.driven(self.rig.vibration.law)
        shared = (constants[:4], self.rig.kernel_constants)
        f, f_state, f_const = kernel((state, self.inputs, self.contacts), shared)
        mid_state = 0.5 * (state[:-1] + state[1:]) + h / 8 * (f[:-1] - f[1:])
        fm, fm_state, fm_const = kernel((mid_state, self.inputs_mid, self.contacts_mid), shared)
        weight = np.repeat((np.array([VELOCITY_DRIFT, self.belief.drift]) * h) ** -0.5, 3)
        identity = np.eye(6)
        r = weight * (state[1:] - state[:-1] - h / 6 * (f[:-1] + 4 * fm + f[1:]))
        left = -identity - h / 6 * (f_state[:-1] + 4 * fm_state @ (0.5 * identity + h / 8 * f_state[:-1]))
        right = identity - h / 6 * (f_state[1:] + 4 * fm_state @ (0.5 * identity - h / 8 * f_state[1:]))
        by = np.zeros((K, 6, 5))
        by[:, :, :4] = (
            -h / 6 * (f_const[:-1] + f_const[1:] + 4 * (fm_const + h / 8 * fm_state @ (f_const[:-1] - f_const[1:])))
        )
        arrow = Arrow.empty(K + 1, 5)
        arrow.add_residuals(r, weight[:, None] * left, weight[:, None] * right, weight[:, None] * by)

        # r_i + ρ n_i = 0 for a ball: nine residuals a node, down-weighted as neighbouring nodes have the same
        roundness_weight = 1.0 / (ROUNDNESS_SD_M * np.sqrt(max(ROUNDNESS_TIME_S / h, 1.0)))
        distance = self.contacts[:, :9].reshape(-1, 3, 3) - state[:, None, :3] + constants[4] * self.normals
        arrow.diagonal[:, :3, :3] += 3 * roundness_weight**2 * np.eye(3)
        arrow.border[:, :3, 4] -= roundness_weight**2 * self.normals.sum(1)
        arrow.corner[4, 4] += roundness_weight**2 * (self.normals**2).sum()
        arrow.nodes_gradient[:, :3] -= roundness_weight**2 * distance.sum(1)
        arrow.gradient[4] += roundness_weight**2 * (distance * self.normals).sum()

        prior_error = (constants - self.belief.mean) / self.belief.sd
        arrow.corner += np.diag(self.belief.sd**-2.0)
        arrow.gradient += prior_error / self.belief.sd
        rest_nodes, sd = self.belief.rest_nodes, np.tile(self.belief.state_sd, (self.belief.rest_nodes, 1))
        sd[1:, :3] = np.inf
        state_error = (state[:rest_nodes] - self.belief.state) / sd
        arrow.diagonal[:rest_nodes] += np.eye(6) * (sd**-2.0)[:, None]
        arrow.nodes_gradient[:rest_nodes] += state_error / sd
        cost = (
            (r**2).sum() + roundness_weight**2 * (distance**2).sum() + (prior_error**2).sum() + (state_error**2).sum()
        )
        return float(cost), arrow
