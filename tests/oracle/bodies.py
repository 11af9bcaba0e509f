"""Many bodies on two palms in NumPy: Newton's and Euler's equations from the constraint differentiated twice.

An oracle that shares only the meaning of the constants with the models. Friction is that of vibrating palms
(docs/theory/vibration.md): the equations are solved for each pair of slip signs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from plain_friction import SIGN_PAIRS, by_sign, rippled_directions, sign_shares

ORDER = 12
# ln ρ, B, w, c, ln m, the rig's constants, coefficients of h, possibly more: the smoother's order
LN_RHO, DRAG, SATURATION, DAMPING, LN_MASS, RIG = range(6)
KAPPA, TRANSMISSION, PERIOD, ARM = range(RIG + 15, RIG + 19)  # errors of these; the last two are relative
STEPS = 2  # fixed-point steps of the smoother to a ripple consistent with its sign shares
SHAPE = RIG + 19
CONSTANTS = SHAPE + 2 * ORDER + 1


class Bodies:
    """Many bodies on the same palms, one column of `parameters` each; N c = h differentiated twice gives the motion."""

    def __init__(
        self,
        parameters: np.ndarray,
        gravity: float = 9.81,
        arm: float = 0.0,
        kappa: float = 0.0,
        transmission: float = 1.0,
        half_period: float = 0.0,
    ) -> None:
        """As the rig is described: κ of the palms' vibrations, their transmission λ, 1/(2f)."""
        self.p = parameters
        self.gravity, self.arm = gravity, arm
        self.kappa, self.transmission, self.half_period = kappa, transmission, half_period
        self.k = np.arange(ORDER + 1)[:, None]
        h = parameters[SHAPE:CONSTANTS]
        self.wave = np.concatenate([h[:1] + 0j, h[1::2] - 1j * h[2::2]])  # h = Re Σ wave_k e^{ikθ}

    def support(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """h, h′, h″."""
        terms = self.wave * np.exp(1j * self.k * theta)
        return terms.sum(0).real, (1j * self.k * terms).sum(0).real, (-(self.k**2) * terms).sum(0).real

    def contacts(self, palms: np.ndarray, psi: np.ndarray) -> list[np.ndarray]:
        """s1, s2: position of the contact along each palm, from the COM's coordinates."""
        lengths = []
        com = self.com(palms, psi)
        for number, angle in enumerate((palms[0], palms[0] + palms[1])):
            sign = 1 - 2 * number
            t = sign * np.array([math.cos(angle), math.sin(angle)])
            _, slope, _ = self.support(angle - psi - (math.pi / 2, 3 * math.pi / 2)[number])
            lengths.append(sign * (t @ com + slope))
        return lengths

    def com(self, palms: np.ndarray, psi: np.ndarray) -> np.ndarray:
        """The COM relative to the hinge, from the distances to both palms."""
        phi1, phi12 = palms[0], palms[0] + palms[1]
        N = np.array([[-math.sin(phi1), math.cos(phi1)], [math.sin(phi12), -math.cos(phi12)]])
        one, two = self.support(phi1 - psi - math.pi / 2)[0], self.support(phi12 - psi - 3 * math.pi / 2)[0]
        return np.linalg.solve(N, np.array([one, two]))

    def forces_and_spin(self, palms: np.ndarray, psi: np.ndarray, omega0: np.ndarray) -> np.ndarray:
        """(f1, f2, α0) of every body from the three equations of Newton and Euler in the world frame."""
        phi = np.array([palms[0], palms[0] + palms[1]])
        omega, alpha = (np.array([palms[i], palms[i] + palms[i + 1]]) for i in (2, 4))
        sign = np.array([1.0, -1.0])
        t = sign[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1)
        n = np.stack([-t[:, 1], t[:, 0]], axis=1)
        h, slope, bend = (np.stack(pair) for pair in zip(
            self.support(phi[0] - psi - math.pi / 2), self.support(phi[1] - psi - 3 * math.pi / 2), strict=True
        ))  # fmt: skip
        turning = omega[:, None] - omega0
        # N c = h; N' = −ω t, N'' = −α t − ω² n
        inverse = np.linalg.inv(n)
        c = inverse @ h
        c_dot = inverse @ (slope * turning + omega[:, None] * (t @ c))
        rest = bend * turning**2 + slope * alpha[:, None]
        rest = rest + 2 * omega[:, None] * (t @ c_dot) + alpha[:, None] * (t @ c) + (omega**2)[:, None] * (n @ c)
        still, with_spin = inverse @ rest, inverse @ -slope  # c̈ = still + with_spin α0
        hinge = self.arm * np.array([
            alpha[0] * math.sin(phi[0]) + omega[0] ** 2 * math.cos(phi[0]),
            -alpha[0] * math.cos(phi[0]) + omega[0] ** 2 * math.sin(phi[0]),
        ])  # fmt: skip
        rho, dither = np.exp(self.p[LN_RHO]), self.p[SATURATION] ** -0.5
        mean, asymmetry = self.p[DRAG] * dither, self.p[RIG + 12]
        friction = (mean * (1.0 + asymmetry), mean * (1.0 - asymmetry))
        count = psi.size
        A, b = np.zeros((count, 3, 3)), np.zeros((count, 3))
        A[:, :2, 2] = -with_spin.T
        A[:, 2, 2] = -(rho**2)
        b[:, :2] = (still + hinge[:, None]).T + np.array([0.0, self.gravity])
        b[:, 2] = self.p[DAMPING] * omega0
        longer = self.p[ARM]  # affects friction only: a body larger by this much on palms lower by this much
        arms = [-h[i] * (1 + longer) * n[i][:, None] + slope[i] * t[i][:, None] for i in range(2)]

        def solved(directions: Sequence[np.ndarray | int]) -> np.ndarray:
            for i, (mu, arm, direction) in enumerate(zip(friction, arms, directions, strict=True)):
                pull = n[i][:, None] - mu * direction * t[i][:, None]
                A[:, :2, i] = pull.T
                A[:, 2, i] = arm[0] * pull[1] - arm[1] * pull[0]
            return np.linalg.solve(A, b[..., None])[..., 0].T

        speed = 2 / math.pi * dither
        slips = [  # the palm's own points move along t
            t[i] @ (c_dot + np.stack([-omega0 * arm[1], omega0 * arm[0]])) - longer * h[i] * omega[i]
            for i, arm in enumerate(arms)
        ]
        kappas, transmission = self.kappa + self.p[KAPPA], self.transmission + self.p[TRANSMISSION]
        period = self.half_period * (1 + self.p[PERIOD])
        of_signs = {signs: solved(signs) for signs in SIGN_PAIRS}
        turning = np.array([  # of each slip with the body's rate
            t[i] @ (with_spin + np.stack([-arm[1], arm[0]])) for i, arm in enumerate(arms)
        ])  # fmt: skip
        spins = {signs: each[2] for signs, each in of_signs.items()}

        def drive_of(p: np.ndarray) -> np.ndarray:
            return np.asarray(turning[:, None] * period * by_sign(spins, p))

        means, lag = rippled_directions(np.array(slips), speed, drive_of, kappas, STEPS)
        shares = dict(sign_shares(means, kappas, lag))
        directions = []
        for i, mean in enumerate(means):
            parts = {signs: share * np.maximum(of_signs[signs][i], 0) for signs, share in shares.items()}
            alternating = sum(signs[i] * part for signs, part in parts.items()) / sum(parts.values())
            directions.append(mean + transmission * (alternating - mean))
        return solved(directions)

    def moved(
        self, psi: np.ndarray, omega0: np.ndarray, palms: tuple[np.ndarray, np.ndarray, np.ndarray], dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """(ψ, ω0) after one classical Runge–Kutta step; `palms` at its start, middle and end."""
        before, middle, after = palms
        a1 = self.forces_and_spin(before, psi, omega0)[2]
        w2 = omega0 + dt / 2 * a1
        a2 = self.forces_and_spin(middle, psi + dt / 2 * omega0, w2)[2]
        w3 = omega0 + dt / 2 * a2
        a3 = self.forces_and_spin(middle, psi + dt / 2 * w2, w3)[2]
        w4 = omega0 + dt * a3
        a4 = self.forces_and_spin(after, psi + dt * w3, w4)[2]
        return psi + dt / 6 * (omega0 + 2 * (w2 + w3) + w4), omega0 + dt / 6 * (a1 + 2 * (a2 + a3) + a4)
