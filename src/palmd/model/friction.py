"""Dry friction on palms that vibrate along themselves (docs/theory/vibration.md): the one place where its law stands.

The normal forces alternate with the signs of slip, so that the rigid contact equations are solved for each pair of
signs and averaged with the share of time of each pair. Every function takes CasADi expressions, or NumPy arrays with
`xp` numpy. Safe inside the loop: nothing allocates but arrays, nothing raises.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from palmd.model.symbolic import SX, ca

KINK = 0.02
"""ε of the smooth kink: σ_ε is off by 0.09 at |u| = V and by 1e-4 (RMS) below 0.8 V."""
LEAST_DETERMINANT = 0.02  # of that without friction; less and the body is wedged, where no law of this kind holds
LEAST_FORCE = 1e-9  # m/s², so that 0/0 of a contact that is never loaded is 0
LEAST_RIPPLE = 1e-7  # m/s, so that a ripple has a derivative at 0
LEAST_DIRECTION = 1e-6  # so that a bound on a mean direction has a derivative at 0
LEAST_DRIVE = 0.3
"""Of V: ripple below which sticking is left out (derivation: a_ii is 0.08 V at most, and sticking lasts for less of the
period than the smooth kink rounds off)."""
RELAXED = 0.7
"""Share of the way of each step but the first towards the ripple that agrees with its shares (numerics: whole steps
overshoot, as a larger ripple makes for more equal shares)."""
FRICTION_NOISE_S = 1e-4
"""Spectral density (s) of α0's error over the square of what friction at a contact contributes to α0: 2 ε² τ of a force
that is off by ε = 2 % for τ = 0.12 s at a time (study of resolved vibrations, 2026-11-30, eight demos over wires with
μ 0.05 to 0.25: medians of 0.7e-4 to 4.5e-4; third harmonics of 2 %, as shakers have them, do as much)."""
HOP_NOISE_S = 2.0
"""The same over the square of what would pull where a contact hops (study of resolved vibrations, 2026-11-29: order of
magnitude, as logs differ by more than ten times)."""
BRIEF = KINK / 2  # share of time that the smooth kink leaves to the other sign at a slip of 1.2 V
SIGN_PAIRS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
SLOPE = math.pi / 2
"""u_d = `SLOPE` V: the averaged law with this u_d has the same slope at u = 0 as vibrations of speed V."""


@dataclass(frozen=True, slots=True)
class Vibrated:
    """The palms' vibration as the equations need it.

    dither: u_d = πV/2, V the amplitude of a palm's speed along itself (m/s). kappa: E[s1 s2] at rest, 0 where they
    vibrate independently, −1 in phase (both move away from the hinge at the same time), 1 in antiphase. transmission:
    λ, the share of the alternating friction that the normal forces follow. averaged: 1 for the old law, else 0.
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
    """σ = u/√(u² + u_d²) of the old law, for logs that were simulated by it (`law: averaged`)."""
    return slip / xp.sqrt(slip**2 + dither**2)


def sign_shares(sigma: Sequence[Any], kappa: Any, lag: Any = 0.0, xp: Any = ca) -> tuple[Any, Any, Any, Any]:
    """Shares of time of the slip signs (+,+), (+,−), (−,+), (−,−) of both palms (section 2).

    P(++) = (1 − |κ|) p1 p2 + |κ| P, p_i = (1 + σ_i)/2, where P is that of one frequency: ½ (o(x) + o(2 − x)),
    o(x) = max(0, min(p1 + p2 − x, 2 p1, 2 p2)), x = δ/π. lag: by how many periods the one contact's forward slip is
    later than the other's, besides what the palms' phase makes of it: x = 2 |lag| in antiphase (κ > 0), 1 − 2 |lag| in
    phase. Without lag P is min(p1, p2) and max(0, p1 + p2 − 1).
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
    A: Sequence[Sequence[Any]], B: Sequence[Sequence[Any]], b: Sequence[Any], friction: Sequence[Any], xp: Any = ca
) -> tuple[Any, Any]:
    """f1, f2 of (A − B diag(friction)) f = b (section 1), friction μ_i times the direction of slip at contact i.

    The determinant is that of a body which is not wedged: at least `LEAST_DETERMINANT` of the one without friction.
    """
    (m11, m12), (m21, m22) = matrix = _with(A, B, friction)
    determinant = xp.fmax(_determinant(matrix), LEAST_DETERMINANT * _determinant(A))
    return (b[0] * m22 - b[1] * m12) / determinant, (m11 * b[1] - m21 * b[0]) / determinant


def _with(A: Sequence[Sequence[Any]], B: Sequence[Sequence[Any]], friction: Sequence[Any]) -> list[list[Any]]:
    return [[a - c * s for a, c, s in zip(*rows, friction, strict=True)] for rows in zip(A, B, strict=True)]


def _determinant(matrix: Sequence[Sequence[Any]]) -> Any:
    return matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0]


def wedged(A: Sequence[Sequence[Any]], B: Sequence[Sequence[Any]], friction: Sequence[Any]) -> Any:
    """Whether this friction holds the body whatever presses it: no forces that press solve the equations."""
    return _determinant(_with(A, B, friction)) < LEAST_DETERMINANT * _determinant(A)


def sign_pair_forces(
    A: Sequence[Sequence[Any]], B: Sequence[Sequence[Any]], b: Sequence[Any], mu: Sequence[Any], xp: Any = ca
) -> tuple[tuple[Any, ...], ...]:
    """f1, f2 for each of `SIGN_PAIRS` (section 1), mu of each palm; negative of a contact that would be pulled."""
    return tuple(normal_forces(A, B, b, friction, xp) for friction in _by_pair(mu))


def _by_pair(mu: Sequence[Any]) -> list[list[Any]]:
    return [[m * s for m, s in zip(mu, signs, strict=True)] for signs in SIGN_PAIRS]


def effective_directions(
    forces: Sequence[Sequence[Any]], sigma: Sequence[Any], shares: Sequence[Any], transmission: Any, xp: Any = ca
) -> tuple[Any, Any]:
    """The directions with which one solve gives the averaged law: σ_i + λ (σ_eff,i − σ_i), σ_eff,i = E[s_i f_i]/E[f_i].

    Sections 1 and 3. forces: `sign_pair_forces`. sigma: mean direction of slip on each palm; shares: `sign_shares`. A
    contact that would be pulled under a pair of signs bears nothing then, so that each direction stays within ±1.
    """
    mean, along = [LEAST_FORCE, LEAST_FORCE], [0.0, 0.0]
    for share, signs, pressed in zip(shares, SIGN_PAIRS, forces, strict=True):
        for i, (force, sign) in enumerate(zip(pressed, signs, strict=True)):
            part = share * xp.fmax(force, 0)
            mean[i], along[i] = mean[i] + part, along[i] + sign * part
    one, two = (s + transmission * (a / m - s) for s, a, m in zip(sigma, along, mean, strict=True))
    return one, two


@dataclass(frozen=True, slots=True)
class SlipResponse:
    """How the slip of both contacts responds to friction that alternates.

    turning: G_i = ∂u_i/∂ω0 (m), by which the slip at contact i changes as the body turns with both contacts kept. d, r:
    of both contacts as in `model.contact`. rho2: ρ² (m²). half_period: 1/(2f) of the vibration (s), 0 for none of it.
    """

    turning: Sequence[Any]
    d: Sequence[Any]
    r: Sequence[Any]
    rho2: Any
    half_period: Any


def drives(
    forces: Sequence[Sequence[Any]], mu: Sequence[Any], body: SlipResponse
) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """By how much (m/s) a sign that alternates drives each slip: D_ij = G_i ∂α0/∂s_j /f, j the contact that alternates.

    The derivative is the mean over the other contact's sign. Negative on the diagonal, unless the normal forces
    alternate by more than friction.
    """
    both, one_only, two_only, none = (
        -sum(f * (d + m * s * r) for f, d, r, m, s in zip(pressed, body.d, body.r, mu, signs, strict=True)) / body.rho2
        for pressed, signs in zip(forces, SIGN_PAIRS, strict=True)
    )  # α0 of each pair, but for what all have
    by = both - two_only + one_only - none, both - one_only + two_only - none
    one, two = (tuple(turning * body.half_period / 2 * each for each in by) for turning in body.turning)
    return one, two


def softened_speeds(speed: Any, drive: Sequence[Sequence[Any]], xp: Any = ca) -> tuple[Any, Any]:
    """V/√(1 + a_i²/V²) of each contact, with a_i² = (D_ii² + D_ij²/3)/16: in slow slip a ripple as if V were so small.

    A ripple of a_i makes the mean direction steeper at u = 0 as √(V² − a_i²) for V would, and this is the same to
    second order. Nothing in it jumps where the ripple begins to stick.
    """
    one, two = (speed / xp.sqrt(1 + (drive[i][i] ** 2 + drive[i][1 - i] ** 2 / 3) / (4 * speed) ** 2) for i in range(2))
    return one, two


def _swung(x: SX, share: SX) -> SX:
    """∫(s − σ) of a sign that is forward for a `share` of the period about x = 0; x and the integral in periods."""
    x = x - ca.floor(x + 0.5)
    rising, falling, fallen = 2 * (1 - share) * x, share * (1 - 2 * x), share * (1 + 2 * x)
    return ca.fmax(ca.fmin(rising, falling), -fallen)


def _beyond(room: SX, stray: SX, drive: SX) -> SX:
    """√(1 − 4 room/drive): the least mean direction where there is so much `room` (m/s), ± `stray`, for the ripple."""
    one, other = (
        ca.sqrt(ca.fmax(1 - 4 * ca.fmax(each, 0) / drive, LEAST_DIRECTION**2)) for each in (room + stray, room - stray)
    )
    return (one + other) / 2 - 2 * LEAST_DIRECTION  # below 0 where nothing sticks, so that no maximum is between equals


def rippled_directions(
    slips: Sequence[SX], speed: SX, drive: Sequence[Sequence[SX]], kappa: SX, steps: int = 1
) -> tuple[tuple[SX, SX], SX]:
    """Mean direction of each slip, and the lag (periods) of slip 1 behind slip 2, the body's own ripple included.

    Each sign that alternates makes the body turn to and fro, so that a slip is not u_i + V cos τ but has triangles
    Σ_j D_ij ∫(s_j − σ_j) besides (docs/theory/vibration.md, ripple). A contact reverses at u_i + w, where w is what
    these are just then: a_ii = D_ii p_i (1 − p_i) backwards, −a_ii forwards of its own, of an independent palm's
    anything between ±a_ij (RMS a_ij/√3), of one with the same frequency what its phase makes of it, which puts both
    slips out of phase. The ripple cannot carry a slip beyond the vibration's reversal: where |u_i| + |a_ii| > V, the
    contact sticks for part of the period, so that |a_ii| is V − |u_i| and σ_i² = 1 − 4 (V − |u_i|)/|D_ii|, 1 from V on.
    drive: `drives`.
    """
    together, antiphase = ca.fabs(kappa), ca.fmax(ca.sign(kappa), 0)
    apart, shift = 1 - together, (1 - antiphase) / 2
    sigma, lags = [mean_direction(u / speed) for u in slips], [SX(0), SX(0)]
    for step in range(steps):
        part = RELAXED if step else 1.0
        shares = [(1 + each) / 2 for each in sigma]
        tips = [each * (1 - each) for each in shares]
        found, late = [], []
        for i, u in enumerate(slips):
            j = 1 - i
            own, other = drive[i][i] * tips[i], drive[i][j] * tips[j]
            stray = apart * ca.fabs(other) / math.sqrt(3)
            spread = apart * ca.sqrt(own**2 + other**2 / 3 + LEAST_RIPPLE**2)
            away = lags[i] - lags[j] + shift
            backward, forward = (
                together * drive[i][j] * _swung(away + side * shares[i] / 2, shares[j]) for side in (1, -1)
            )
            alone = together * own - spread
            ends = [ca.fmax(ca.fmin(each, speed), -speed) for each in (backward + alone, forward - alone)]
            end, begin = (mean_direction((u + each) / speed) for each in ends)
            mean, least = (end + begin) / 2, LEAST_DRIVE * speed
            damping = ca.fmax(-drive[i][i], least)
            sticking = 1 / (1 + (least / ca.fmax(-drive[i][i], LEAST_RIPPLE)) ** 4)
            mean = mean + sticking * (
                ca.fmax(_beyond(speed - u - forward, stray, damping) - ca.fmax(mean, 0), 0)
                - ca.fmax(_beyond(speed + u + backward, stray, damping) - ca.fmax(-mean, 0), 0)
            )
            found.append(sigma[i] + part * (mean - sigma[i]))
            late.append(lags[i] + part * ((end - begin) / 8 - lags[i]))
        sigma, lags = found, late
    return (sigma[0], sigma[1]), lags[0] - lags[1]


def pulled(forces: Sequence[Sequence[Any]], shares: Sequence[Any], mu: Sequence[Any], body: SlipResponse) -> Any:
    """The part of α0 (rad/s²) that comes of contacts being pulled, which hop instead, all of one sign."""
    return sum(
        share * ca.fmax(-f, 0) * ca.fabs(d + m * s * r) / body.rho2
        for pressed, share, signs in zip(forces, shares, SIGN_PAIRS, strict=True)
        for f, m, s, d, r in zip(pressed, mu, signs, body.d, body.r, strict=True)
    )


@dataclass(frozen=True, slots=True)
class Averaged:
    """What friction does in the mean over the vibration.

    directions: of friction at each contact, with which one solve of the contact equations gives the mean forces;
    softened: the same by `softened_speeds`, which vary with the slips about as much as the ripple makes `directions`
    vary, and without jumps. pair_forces, shares, wedged: normal forces (m/s²) and share of time of each of
    `SIGN_PAIRS`, and whether the body is wedged then. transmission: λ, 0 with the averaged law. pulled: see the
    function of that name.
    """

    directions: tuple[SX, ...]
    softened: tuple[SX, ...]
    pair_forces: tuple[tuple[SX, ...], ...]
    shares: tuple[SX, ...]
    wedged: tuple[SX, ...]
    transmission: SX
    pulled: SX

    def least_forces(self, means: Sequence[SX]) -> tuple[SX, ...]:
        """The least force on each contact within a vibration (m/s²), of these mean forces; at 0 it hops.

        Of the sign pairs that last for more than `BRIEF` of the time; in which the body is wedged it is below 0.
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
    """Friction at both contacts, of slips u_i (m/s), by the law that the vibration asks for."""
    forces = sign_pair_forces(A, B, b, mu)
    speed, kappa, law = vibrated.dither / SLOPE, vibrated.kappa, 1 - vibrated.averaged
    transmission = vibrated.transmission * law
    old = [averaged_direction(u, vibrated.dither) for u in slip]

    def directions(new: Sequence[SX], lag: SX) -> tuple[tuple[SX, ...], tuple[SX, ...]]:
        sigma = [s + vibrated.averaged * (o - s) for s, o in zip(new, old, strict=True)]
        shares = sign_shares(sigma, kappa, lag)
        return effective_directions(forces, sigma, shares, transmission), shares

    drive = drives(forces, mu, body)
    found, shares = directions(*rippled_directions(slip, speed, drive, kappa, steps))
    slower = softened_speeds(speed, drive)
    softened, _ = directions([mean_direction(u / v) for u, v in zip(slip, slower, strict=True)], SX(0))
    held = tuple(wedged(A, B, friction) for friction in _by_pair(mu))
    hopping = transmission * pulled(forces, shares, mu, body)
    return Averaged(found, softened, forces, shares, held, transmission, hopping)
