"""Independent shape-map model in NumPy from the textbook equations, to check the generated C.

Columns are independent states. With 1e-30·i added to one state each, the imaginary parts are the exact Jacobian
(complex-step differentiation).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from plain_friction import SIGN_PAIRS, by_sign, positive, rippled_directions, sign_shares, softened_direction

from palmd.events import FloatArray
from palmd.model.friction import FRICTION_NOISE_S, HOP_NOISE_S, LEAST_FORCE
from palmd.model.shape import HARMONICS
from palmd.model.shape_map import N, Z

Array = npt.NDArray[Any]  # real or complex

EPSILON = 1e-30
_K = np.arange(1, HARMONICS + 1)[:, None]
_SERIES_TERMS = 20
_LOG_MU_STEP = 1e-5
_OWN_RATE_STEP = 3e-4  # rad/s; changes slips by far less than the speed that hides friction


def contact(theta: Array, coefficients: Array) -> tuple[Array, Array, Array]:
    """r = h, d = −h′, v = h + h″ (m) where the outward normal is `theta`."""
    cos, sin = np.cos(_K * theta), np.sin(_K * theta)
    a0, a, b = coefficients[0], coefficients[1::2], coefficients[2::2]
    wave, slope = a * cos + b * sin, _K * (b * cos - a * sin)
    h, h1, h2 = a0 + wave.sum(axis=0), slope.sum(axis=0), -(_K**2 * wave).sum(axis=0)
    return h, -h1, h + h2


def reading(x: Array, phi1: float, phi2: float, pad: int) -> Array:
    """s1 (3.13) or s2 (3.14), m."""
    (r1, d1, _), (r2, d2, _) = _contacts(x, phi1, phi2)
    if pad == 1:
        return np.asarray((r1 * math.cos(phi2) + r2) / math.sin(phi2) - d1)
    return np.asarray((r2 * math.cos(phi2) + r1) / math.sin(phi2) + d2)


def reading_row(x: FloatArray, phi1: float, phi2: float, pad: int) -> tuple[float, FloatArray]:
    """The reading (m) and its derivative in the state."""
    s = reading(_perturbed(x), phi1, phi2, pad)
    return float(s[0].real), s.imag / EPSILON


def spin_rate(x: Array, palms: FloatArray, rig: FloatArray) -> Array:
    """α0 (rad/s²) of states, a column each; see `motion`."""
    return motion(x, palms, rig)[0]


def motion(x: Array, palms: FloatArray, rig: FloatArray) -> tuple[Array, Array, Array]:
    """α0 (rad/s²), the density of its error ((rad/s²)²/Hz), and α0 of softened friction (rad/s²).

    Per unit mass, unknowns (f1, f2, α0); palms φ1 … α2, rig as `rig_inputs`. With N = (n1, n2)ᵀ and c the centre of
    mass, N c = r twice differentiated gives n_i·a; a = Σ f_j F_j + g. On vibrating palms the directions of friction are
    E[s f]/E[f] over the signs s of both slips (docs/theory/vibration.md); the body's ripple shortens their alternation.
    """
    phi1, phi2, omega1, omega2, alpha1, alpha2 = palms
    angle = np.array([phi1, phi1 + phi2])
    rate, acceleration = np.array([omega1, omega1 + omega2]), np.array([alpha1, alpha1 + alpha2])
    sign = np.array([1.0, -1.0])
    t = sign * np.array([np.cos(angle), np.sin(angle)])  # one column per palm
    n = np.array([-t[1], t[0]])
    omega0, mu = x[Z.OMEGA0], x[Z.MU]
    rho2, dither, damping = np.exp(2 * x[Z.LN_RHO]), np.exp(x[Z.LN_DITHER]), x[Z.DAMPING]
    r, d, v = (np.array(pair) for pair in zip(*_contacts(x, phi1, phi2), strict=True))

    theta1 = rate[:, None] - omega0  # θ̇ of each contact
    to_plane = np.linalg.inv(n.T)  # w from (n1·w, n2·w)
    c = to_plane @ r
    c1 = to_plane @ (-d * theta1 + rate[:, None] * (t.T @ c))  # ċ, since ṅ = −ω t and ṙ = −d θ̇
    gravity = np.array([0.0, -rig[0]]) + rig[1] * (alpha1 * n[:, 0] - omega1**2 * t[:, 0])
    longer = rig[14]  # relative increase of friction's arm over the radius
    arms = r * (1 + longer)
    slip = t.T @ c1 + omega0 * arms - longer * rate[:, None] * r

    # n·a = r̈ − 2 ṅ·ċ − n̈·c with n̈ = −α t − ω² n and r̈ = (v − r) θ̇² − d (α − α0); α0's part moves to the left
    known = (v - r) * theta1**2 - d * acceleration[:, None]
    known = known + 2 * rate[:, None] * (t.T @ c1) + acceleration[:, None] * (t.T @ c) + rate[:, None] ** 2 * r

    def solved(direction: Any) -> Array:
        """(f1, f2, α0) with friction −μ f_j along each t_j times these directions."""
        left = np.zeros((x.shape[1], 3, 3), dtype=x.dtype)
        right = np.zeros((x.shape[1], 3), dtype=x.dtype)
        for j in range(2):
            force = n[:, j, None] - mu * direction[j] * t[:, j, None]
            arm = -(arms[j] * n[:, j, None] + d[j] * t[:, j, None])
            left[:, :2, j] = (n.T @ force).T
            left[:, j, 2] = -d[j]
            left[:, 2, j] = arm[0] * force[1] - arm[1] * force[0]
        left[:, 2, 2] = -rho2
        right[:, :2] = (known - (n.T @ gravity)[:, None]).T
        right[:, 2] = damping * omega0
        return np.asarray(np.linalg.solve(left, right[:, :, None])[:, :, 0].T)

    kappa, transmission, averaged, half_period, kappa_off, transmission_off, period_off = rig[7:14]
    if averaged:
        spin = np.asarray(solved(slip / np.sqrt(slip**2 + dither**2))[2])
        return spin, np.zeros(x.shape[1]), spin
    kappa, speed = min(max(kappa + kappa_off, -1.0), 1.0), 2 / math.pi * dither
    half_period *= max(1.0 + period_off, 0.0)
    each = {signs: solved(signs) for signs in SIGN_PAIRS}
    turning = t.T @ (to_plane @ d) + arms  # of each slip with ω0
    spins = {signs: of[2] for signs, of in each.items()}

    def drive_of(p: Array) -> Array:
        return np.asarray(turning[:, None] * half_period * by_sign(spins, p))

    follows = transmission + transmission_off

    def averaged_over(mean: Array, lag: Array) -> tuple[Array, Array]:
        """Directions of friction, and the part of α0 due to pulled contacts."""
        forces, rubbed, pulled = np.full_like(mean, LEAST_FORCE), np.zeros_like(mean), 0.0
        for signs, share in sign_shares(mean, kappa, lag):
            s = np.array(signs)[:, None]
            force = share * positive(each[signs][:2])
            forces, rubbed = forces + force, rubbed + s * force
            pulled = pulled + (share * positive(-each[signs][:2]) * np.abs(d + mu * s * arms) / rho2).sum(axis=0)
        return mean + follows * (rubbed / forces - mean), follows * pulled

    directions, pulled = averaged_over(*rippled_directions(slip, speed, drive_of, kappa))
    softened, _ = averaged_over(
        softened_direction(slip, speed, drive_of(np.full_like(slip, 0.5))), np.zeros(x.shape[1])
    )
    steps = _LOG_MU_STEP * np.eye(2)[:, :, None]
    by_mu = [(solved(directions * (1 + h))[2] - solved(directions * (1 - h))[2]) / (2 * _LOG_MU_STEP) for h in steps]
    error = FRICTION_NOISE_S * (by_mu[0] ** 2 + by_mu[1] ** 2) + HOP_NOISE_S * pulled**2
    return np.asarray(solved(directions)[2]), error, np.asarray(solved(softened)[2])


def left_open(x: FloatArray, u: FloatArray) -> float:
    """Variance ((rad/s)²) of ω0 after a step due to the friction law's error; u as in `transition`.

    For white noise in α0 with ω0 relaxing at softened friction's rate: q (e^{2 z} − 1)/2z dt.
    """
    state = x[:, None].astype(complex)
    rate = _own_rate(state, u[1:7], u[9:])
    return float((motion(state, u[1:7], u[9:])[1] * _phi(1, 2 * rate * u[0]) * u[0])[0].real)


def transition(x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(x after the step, its Jacobian); u as `shape_map.predict_function` takes it."""
    columns = _moved(_perturbed(x), u)
    return columns[:, 0].real.copy(), columns.imag / EPSILON


def _moved(x: Array, u: FloatArray) -> Array:
    """ETDRK4 (Cox and Matthews 2002), exact for softened friction's rate of ω0; Runge–Kutta when that rate is zero."""
    dt, palms, jerk, rig = u[0], u[1:7], u[7:9], u[9:]

    own_rate = _own_rate(x, palms, rig)
    z = np.stack([np.zeros_like(own_rate), own_rate * dt])

    def rest(y: Array, t: float) -> Array:
        state = np.concatenate([y, x[2:]])
        phi = palms[:2] + t * palms[2:4] + t**2 / 2 * palms[4:] + t**3 / 6 * jerk
        omega, alpha = palms[2:4] + t * palms[4:] + t**2 / 2 * jerk, palms[4:] + t * jerk
        spin = spin_rate(state, np.concatenate([phi, omega, alpha]), rig)
        return np.array([y[1], spin - own_rate * y[1]])

    y = x[:2]
    half, to_middle = np.exp(z / 2), dt / 2 * _phi(1, z / 2)
    n0 = rest(y, 0.0)
    a = half * y + to_middle * n0
    n1 = rest(a, dt / 2)
    b = half * y + to_middle * n1
    n2 = rest(b, dt / 2)
    c = half * a + to_middle * (2 * n2 - n0)
    n3 = rest(c, dt)
    p1, p2, p3 = (dt * _phi(k, z) for k in (1, 2, 3))
    y = np.exp(z) * y + (p1 - 3 * p2 + 4 * p3) * n0 + 2 * (p2 - 2 * p3) * (n1 + n2) + (4 * p3 - p2) * n3
    return np.concatenate([y, x[2:]])


def _own_rate(x: Array, palms: FloatArray, rig: FloatArray) -> Array:
    """∂α0/∂ω0 (1/s) of softened friction."""

    def spin_at(off: float) -> Array:
        elsewhere = x.copy()
        elsewhere[Z.OMEGA0] += off
        return motion(elsewhere, palms, rig)[2]

    h = _OWN_RATE_STEP
    return np.asarray((8 * (spin_at(h) - spin_at(-h)) - (spin_at(2 * h) - spin_at(-2 * h))) / (12 * h))


def _phi(order: int, z: Array) -> Array:
    """φ_k(z) = Σ zⁿ/(n + k)!; beyond |z| = 1 by φ_k = (φ_(k−1) − 1/(k − 1)!)/z from φ_0 = eᶻ."""
    small = np.abs(z) < 1.0
    near, far = np.where(small, z, 0.0), np.where(small, 1.0, z)
    series = sum((near**n / math.factorial(n + order) for n in range(_SERIES_TERMS)), np.zeros_like(z))
    closed = np.exp(far)
    for k in range(order):
        closed = (closed - 1.0 / math.factorial(k)) / far
    return np.where(small, series, closed)


def _contacts(x: Array, phi1: float, phi2: float) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    theta1, theta2 = phi1 - x[Z.PSI] - math.pi / 2, phi1 + phi2 - x[Z.PSI] - 3 * math.pi / 2
    return contact(theta1, x[Z.SHAPE :]), contact(theta2, x[Z.SHAPE :])


def _perturbed(x: FloatArray) -> Array:
    return x[:, None] + 1j * EPSILON * np.eye(N)
