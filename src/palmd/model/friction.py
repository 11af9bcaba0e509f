"""The law of dry friction on palms that vibrate along themselves (docs/theory/vibration.md; sections refer to it).

The normal forces alternate with the signs of slip, so the rigid contact equations are solved for each pair of
signs and averaged, weighted by each pair's share of time. Functions take CasADi expressions, or NumPy arrays if their
argument `xp` is numpy. Safe inside the loop: nothing allocates but arrays, nothing raises.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from palmd.model.symbolic import SX, ca

KINK = 0.02
"""ε of the smooth kink: the error of σ_ε is 0.09 at |u| = V and 1e-4 (RMS) below 0.8 V."""
LEAST_DETERMINANT = 0.02  # relative to the one without friction; below it the body is wedged and the law does not hold
LEAST_FORCE = 1e-9  # m/s²; gives 0 instead of 0/0 for a contact that is never loaded
LEAST_RIPPLE = 1e-7  # m/s; gives the ripple a derivative at 0
STICKING = (
    (0.1155, 0.5881, 0.4392, 1.0355),
    (0.3783, 1.3752, -1.8168, -3.7489),
    (-0.0978, -1.8861, 1.0423, 3.4265),
)
"""Coefficients of `sticking_direction`, of x^i ((D − 3.5)/2)^j (numerics: fit of the exact solution of one
contact, 0.002 to 0.004 RMS and 0.02 at most from D 0.3 to 5.3 with `rippled_directions`: tools/fit_sticking.py)."""
STICKING_AT_REST, STICKING_DRIVE, MOST_DRIVE = 3.4, 0.3, 5.3
"""In units of V: drive from which a contact sticks even in slow slip (derivation: (D/4)² + (D/2π)² = 1, 3.37); from
which it sticks noticeably near u = V (numerics); and the largest for which the law holds: beyond 2π it never slips."""
RELAXED = 0.7
"""Relaxation factor of every iteration but the first towards the ripple that is consistent with its time shares
(numerics: full steps overshoot, as a larger ripple makes the shares more equal)."""
FRICTION_NOISE_S = 2e-4
"""Spectral density (s) of α0's error, divided by the square of friction's contribution to α0 at a contact: 2 ε² τ for
a force with an error of ε = 3 % that lasts for τ = 0.12 s (study 2026-12-01, true motion and constants in the law:
medians of 0.03e-4 to 2.5e-4 in 13 logs of Drake, μ 0.05 to 0.26; in an exploration in MuJoCo, μ 0.19, 5e-4 at
openings below 45°, 2.5e-4 up to 60°, less beyond)."""
FRICTION_ERROR_S = 0.12  # s for which an error of the law lasts: τ above
HOP_NOISE_S = 2.0
"""The same, divided by the square of the α0 that pulling contacts would contribute, where they hop instead (study of
resolved vibrations, 2026-11-29: order of magnitude, as logs differ by more than a factor of ten)."""
BRIEF = KINK / 2  # share of time of the opposite sign that the smooth kink leaves at a slip of 1.2 V
SIGN_PAIRS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
SLOPE = math.pi / 2
"""u_d = `SLOPE` V: the averaged law with this u_d has the same slope at u = 0 as vibrations of speed V."""


@dataclass(frozen=True, slots=True)
class Vibrated:
    """Parameters of the palms' vibration in the equations of motion.

    dither: u_d = πV/2, V the amplitude of a palm's speed along itself (m/s). kappa: E[s1 s2] at rest, 0 for palms that
    vibrate independently, −1 in phase (both move away from the hinge at the same time), 1 in antiphase. transmission:
    λ, the share of the alternating friction that the normal forces follow. averaged: 1 for the averaged law, else 0.
    """

    dither: SX
    kappa: SX
    transmission: SX
    averaged: SX


def mean_direction(ratio: Any, xp: Any = ca, kink: float = KINK) -> Any:
    """σ_ε(u/V) = (2/π) atan(x S/(ε C)), a smooth form of (2/π) asin(x) within ±1 and of ±1 beyond (section 5).

    ratio: slip over the speed of the vibration, x = u/V. C² = 1 + S² with 2 S² = y + √(y² + 4 ε²), y = x² + ε² − 1,
    which is section 5's C without the difference C² − 1. kink: ε.
    """
    y = ratio**2 + kink**2 - 1
    squared = (y + xp.sqrt(y**2 + 4 * kink**2)) / 2
    return 2 / math.pi * xp.arctan(ratio / kink * xp.sqrt(squared / (1 + squared)))


def averaged_direction(slip: Any, dither: Any, xp: Any = ca) -> Any:
    """σ = u/√(u² + u_d²) of the former law, for logs that were simulated with it (`law: averaged`)."""
    return slip / xp.sqrt(slip**2 + dither**2)


def sign_shares(sigma: Sequence[Any], kappa: Any, lag: Any = 0.0, xp: Any = ca) -> tuple[Any, Any, Any, Any]:
    """Return the shares of time of the slip signs (+,+), (+,−), (−,+), (−,−) of both palms (section 2).

    P(++) = (1 − |κ|) p1 p2 + |κ| P, p_i = (1 + σ_i)/2, where P holds for equal frequencies: ½ (o(x) + o(2 − x)),
    o(x) = max(0, min(p1 + p2 − x, 2 p1, 2 p2)), x = δ/π. lag: delay (periods) of one contact's forward slip behind the
    other's, beyond the palms' phase: x = 2 |lag| in antiphase (κ > 0), 1 − 2 |lag| in phase. Without lag P is
    min(p1, p2) and max(0, p1 + p2 − 1).
    """
    p1, p2 = ((1 + each) / 2 for each in sigma)
    late = 2 * xp.fabs(lag)

    def overlap(x: Any) -> Any:
        return xp.fmax(xp.fmin(p1 + p2 - x, 2 * xp.fmin(p1, p2)), 0) / 2

    in_antiphase, in_phase = overlap(late) + overlap(2 - late), overlap(1 - late) + overlap(1 + late)
    both = p1 * p2
    both = both + xp.fmax(kappa, 0) * (in_antiphase - both) + xp.fmax(-kappa, 0) * (in_phase - both)
    return both, p1 - both, p2 - both, 1 - p1 - p2 + both


def normal_forces(
    A: Sequence[Sequence[Any]], B: Sequence[Sequence[Any]], b: Sequence[Any], friction: Sequence[Any]
) -> tuple[Any, Any]:
    """Solve (A − B diag(friction)) f = b for f1, f2 (section 1); friction: μ_i times the slip direction at contact i.

    The determinant is bounded below by `LEAST_DETERMINANT` times the one without friction, as if not wedged.
    """
    (m11, m12), (m21, m22) = matrix = _with(A, B, friction)
    determinant = ca.fmax(_determinant(matrix), LEAST_DETERMINANT * _determinant(A))
    return (b[0] * m22 - b[1] * m12) / determinant, (m11 * b[1] - m21 * b[0]) / determinant


def _with(A: Sequence[Sequence[Any]], B: Sequence[Sequence[Any]], friction: Sequence[Any]) -> list[list[Any]]:
    return [[a - c * s for a, c, s in zip(*rows, friction, strict=True)] for rows in zip(A, B, strict=True)]


def _determinant(matrix: Sequence[Sequence[Any]]) -> Any:
    return matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0]


def wedged(A: Sequence[Sequence[Any]], B: Sequence[Sequence[Any]], friction: Sequence[Any]) -> Any:
    """True if friction alone holds the body: no positive normal forces solve the equations."""
    return _determinant(_with(A, B, friction)) < LEAST_DETERMINANT * _determinant(A)


def sign_pair_forces(
    A: Sequence[Sequence[Any]], B: Sequence[Sequence[Any]], b: Sequence[Any], mu: Sequence[Any]
) -> tuple[tuple[Any, ...], ...]:
    """Return f1, f2 for each of `SIGN_PAIRS` (section 1), mu of each palm; negative where a contact would pull."""
    return tuple(normal_forces(A, B, b, friction) for friction in _by_pair(mu))


def _by_pair(mu: Sequence[Any]) -> list[list[Any]]:
    return [[m * s for m, s in zip(mu, signs, strict=True)] for signs in SIGN_PAIRS]


def effective_directions(
    forces: Sequence[Sequence[Any]], sigma: Sequence[Any], shares: Sequence[Any], transmission: Any
) -> tuple[Any, Any]:
    """Return directions for which one solve gives the mean: σ_i + λ (σ_eff,i − σ_i), σ_eff,i = E[s_i f_i]/E[f_i].

    Sections 1 and 3. forces: `sign_pair_forces`. sigma: mean direction of slip on each palm; shares: `sign_shares`. A
    contact that would pull under a pair of signs counts with zero force, so that each direction stays within ±1.
    """
    mean, along = [LEAST_FORCE, LEAST_FORCE], [0.0, 0.0]
    for share, signs, pressed in zip(shares, SIGN_PAIRS, forces, strict=True):
        for i, (force, sign) in enumerate(zip(pressed, signs, strict=True)):
            part = share * ca.fmax(force, 0)
            mean[i], along[i] = mean[i] + part, along[i] + sign * part
    one, two = (s + transmission * (a / m - s) for s, a, m in zip(sigma, along, mean, strict=True))
    return one, two


@dataclass(frozen=True, slots=True)
class SlipResponse:
    """Response of both contacts' slip to alternating friction.

    turning: G_i = ∂u_i/∂ω0 (m), change of the slip at contact i as the body turns with both contacts closed. d, r: of
    both contacts as in `model.contact`. rho2: ρ² (m²). half_period: 1/(2f) of the vibration (s); 0 disables the ripple.
    """

    turning: Sequence[Any]
    d: Sequence[Any]
    r: Sequence[Any]
    rho2: Any
    half_period: Any


def drives(
    forces: Sequence[Sequence[Any]], mu: Sequence[Any], body: SlipResponse, shares: Sequence[Any]
) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Return how far an alternating sign drives each slip (m/s): D_ij = G_i ∂α0/∂s_j /f, j the alternating contact.

    The derivative is a mean over the other contact's sign, of which `shares` are the shares of forward slip of each
    contact. Negative on the diagonal, unless the normal forces alternate by more than friction.
    """
    both, one_only, two_only, none = (
        -sum(f * (d + m * s * r) for f, d, r, m, s in zip(pressed, body.d, body.r, mu, signs, strict=True)) / body.rho2
        for pressed, signs in zip(forces, SIGN_PAIRS, strict=True)
    )  # α0 of each pair, without the part common to all
    p1, p2 = shares
    by = p2 * (both - two_only) + (1 - p2) * (one_only - none), p1 * (both - one_only) + (1 - p1) * (two_only - none)
    one, two = (tuple(turning * body.half_period * each for each in by) for turning in body.turning)
    return one, two


def sticking_direction(ratio: Any, drive: Any) -> Any:
    """Return the mean direction of a contact that sticks at its reversals, as its own friction drives its slip.

    ratio: mean slip over the speed of the vibration; drive: −D_ii/V, up to `MOST_DRIVE`. It sticks where friction
    changes its slip faster than the vibration does (docs/theory/vibration.md, ripple).
    """
    x = ca.fmax(ca.fmin(ratio, 1), -1)
    size, z, shape = ca.fabs(x), (drive - 3.5) / 2, 0.0
    for row in reversed(STICKING):
        coefficient = 0.0
        for each in reversed(row):
            coefficient = coefficient * z + each
        shape = shape * size + coefficient
    return x * (1 + (1 - size) * shape)


def _sticking_share(drive: Any, limit: float, sharpness: int) -> Any:
    """How far a drive is beyond a limit, 0 to 1; the sharpness is part of the fit of `STICKING`."""
    return drive**sharpness / (drive**sharpness + limit**sharpness)


def _always_sticking(drive: Any) -> Any:
    return _sticking_share(drive, STICKING_AT_REST, 24)


def _sticking(free: Any, sticking: Any, ratio: Any, drive: Any) -> Any:
    """The mean direction out of those of a contact that never sticks and of one that sticks at its reversals.

    Below `STICKING_AT_REST` a contact sticks where that makes its direction larger, above it always.
    """
    forward = ca.sign(ratio)
    larger = forward * ca.fmax(forward * (sticking - free), 0)
    changed = larger + _always_sticking(drive) * (sticking - free - larger)
    return free + _sticking_share(drive, STICKING_DRIVE, 4) * changed


def softened_directions(slips: Sequence[Any], speed: Any, drive: Sequence[Sequence[Any]]) -> tuple[Any, Any]:
    """Return mean directions without iterations, that vary with the slips about as much as `rippled_directions`.

    They do not jump where a contact begins to stick. In slow slip a ripple a² = (D_ii² + D_ij²/3)/16 acts like a
    vibration of V/√(1 + a²/V²), to second order; contacts that always stick follow `sticking_direction`.
    """

    def softened(slip: Any, own: Any, other: Any) -> Any:
        free = mean_direction(slip / speed * ca.sqrt(1 + (own**2 + other**2 / 3) / 16))
        return free + _always_sticking(own) * (sticking_direction(slip / speed, own) - free)

    one, two = (softened(slip, _own_drive(drive[i][i], speed), drive[i][1 - i] / speed) for i, slip in enumerate(slips))
    return one, two


def _own_drive(drive: Any, speed: Any) -> Any:
    return ca.fmin(ca.fmax(-drive / speed, 0), MOST_DRIVE)


def _sign_integral(x: SX, share: SX) -> SX:
    """∫(s − σ) of a sign that is positive for a `share` of the period about x = 0; x and the integral in periods."""
    x = x - ca.floor(x + 0.5)
    rising, falling, fallen = 2 * (1 - share) * x, share * (1 - 2 * x), share * (1 + 2 * x)
    return ca.fmax(ca.fmin(rising, falling), -fallen)


def rippled_directions(
    slips: Sequence[SX],
    speed: SX,
    drives_of: Callable[[Sequence[SX]], Sequence[Sequence[SX]]],
    kappa: SX,
    steps: int = 1,
) -> tuple[tuple[SX, SX], SX]:
    """Return the mean direction of each slip and the lag (periods) of slip 1 behind slip 2, with the body's ripple.

    Each alternating sign makes the body oscillate, which adds the triangle waves Σ_j D_ij ∫(s_j − σ_j) to the slip
    u_i + V cos τ (docs/theory/vibration.md, ripple). A contact reverses at u_i + w, where w is their value at that
    time: from its own sign a_ii = D_ii p_i (1 − p_i) backwards and −a_ii forwards; from an independent palm anything
    between ±a_ij (RMS a_ij/√3); from a palm of the same frequency a value set by its phase, which shifts both slips
    against each other. Where D_ii is large, the contact sticks at its reversals: `sticking_direction`.
    drives_of: `drives` as a function of the other contact's shares of forward slip, ½ for coherent ones: both of their
    signs change together.
    """
    coherent, antiphase = ca.fabs(kappa), ca.fmax(ca.sign(kappa), 0)
    independent, shift = 1 - coherent, (1 - antiphase) / 2
    sigma, lags = [mean_direction(u / speed) for u in slips], [SX(0), SX(0)]
    for step in range(steps):
        part = RELAXED if step else 1.0
        shares = [(1 + each) / 2 for each in sigma]
        drive = drives_of([coherent / 2 + independent * each for each in shares])
        peaks = [each * (1 - each) for each in shares]
        new_sigma, new_lags = [], []
        for i, u in enumerate(slips):
            j = 1 - i
            own, other = drive[i][i] * peaks[i], drive[i][j] * peaks[j]
            stray = independent * ca.fabs(other) / math.sqrt(3)
            spread = independent * ca.sqrt(own**2 + other**2 / 3 + LEAST_RIPPLE**2)
            phase = lags[i] - lags[j] + shift
            backward, forward = (
                coherent * drive[i][j] * _sign_integral(phase + side * shares[i] / 2, shares[j]) for side in (1, -1)
            )
            alone = coherent * own - spread
            ends = [ca.fmax(ca.fmin(each, speed), -speed) for each in (backward + alone, forward - alone)]
            end, begin = (mean_direction((u + each) / speed) for each in ends)
            size, shifted = _own_drive(drive[i][i], speed), u + (backward + forward) / 2
            sticking = (
                sticking_direction((shifted + stray) / speed, size)
                + sticking_direction((shifted - stray) / speed, size)
            ) / 2
            mean = _sticking((end + begin) / 2, sticking, shifted, size)
            new_sigma.append(sigma[i] + part * (mean - sigma[i]))
            new_lags.append(lags[i] + part * ((end - begin) / 8 - lags[i]))
        sigma, lags = new_sigma, new_lags
    return (sigma[0], sigma[1]), lags[0] - lags[1]


def pulled(
    forces: Sequence[Sequence[Any]], shares: Sequence[Any], mu: Sequence[Any], body: SlipResponse
) -> tuple[Any, Any]:
    """Return the parts of α0 (rad/s²) and of the forces (m/s²) due to contacts that would pull, and hop instead.

    Absolute values added.
    """
    pulls = [
        (share * ca.fmax(-f, 0), ca.fabs(d + m * s * r) / body.rho2)
        for pressed, share, signs in zip(forces, shares, SIGN_PAIRS, strict=True)
        for f, m, s, d, r in zip(pressed, mu, signs, body.d, body.r, strict=True)
    ]
    return sum(pull * turning for pull, turning in pulls), sum(pull for pull, _ in pulls)


@dataclass(frozen=True, slots=True)
class Averaged:
    """Friction averaged over the vibration.

    directions: of friction at each contact, for which one solve of the contact equations gives the mean forces;
    softened: the same by `softened_directions`, without jumps.
    pair_forces, shares, wedged: normal forces (m/s²), share of time and wedging of each of `SIGN_PAIRS`. transmission:
    λ, 0 with the averaged law. pulled, pulling_force: both results of `pulled`.
    """

    directions: tuple[SX, ...]
    softened: tuple[SX, ...]
    pair_forces: tuple[tuple[SX, ...], ...]
    shares: tuple[SX, ...]
    wedged: tuple[SX, ...]
    transmission: SX
    pulled: SX
    pulling_force: SX

    def least_forces(self, means: Sequence[SX]) -> tuple[SX, ...]:
        """Return the smallest force on each contact within a vibration (m/s²), given the mean forces; at 0 it hops.

        Over the sign pairs that last longer than `BRIEF` of the time; negative for pairs in which the body is wedged.
        """
        return tuple(self._least(i, mean) for i, mean in enumerate(means))

    def _least(self, contact: int, mean: SX) -> SX:
        least = mean
        for pair, share, wedge in zip(self.pair_forces, self.shares, self.wedged, strict=True):
            pressed = ca.if_else(wedge, -ca.fabs(pair[contact]), pair[contact])
            least = ca.fmin(least, ca.if_else(share > BRIEF, pressed, mean))
        return mean + self.transmission * (least - mean)


def averaged(
    A: Sequence[Sequence[SX]],
    B: Sequence[Sequence[SX]],
    b: Sequence[SX],
    mu: Sequence[SX],
    slip: Sequence[SX],
    vibrated: Vibrated,
    body: SlipResponse,
    steps: int,
) -> Averaged:
    """Return the friction at both contacts for slips u_i (m/s), by the law that `vibrated` selects."""
    forces = sign_pair_forces(A, B, b, mu)
    speed, kappa, resolved = vibrated.dither / SLOPE, vibrated.kappa, 1 - vibrated.averaged
    transmission = vibrated.transmission * resolved
    former = [averaged_direction(u, vibrated.dither) for u in slip]

    def directions(new: Sequence[SX], lag: SX) -> tuple[tuple[SX, ...], tuple[SX, ...]]:
        sigma = [s + vibrated.averaged * (o - s) for s, o in zip(new, former, strict=True)]
        shares = sign_shares(sigma, kappa, lag)
        return effective_directions(forces, sigma, shares, transmission), shares

    def drives_of(shares: Sequence[SX]) -> tuple[tuple[SX, SX], tuple[SX, SX]]:
        return drives(forces, mu, body, shares)

    rippled, shares = directions(*rippled_directions(slip, speed, drives_of, kappa, steps))
    softened, _ = directions(softened_directions(slip, speed, drives_of([SX(0.5), SX(0.5)])), SX(0))
    wedged_pairs = tuple(wedged(A, B, friction) for friction in _by_pair(mu))
    hopping, pulling_force = (transmission * each for each in pulled(forces, shares, mu, body))
    return Averaged(rippled, softened, forces, shares, wedged_pairs, transmission, hopping, pulling_force)
