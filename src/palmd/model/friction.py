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


def sign_shares(sigma: Sequence[Any], kappa: Any, xp: Any = ca) -> tuple[Any, Any, Any, Any]:
    """Shares of time of the slip signs (+,+), (+,−), (−,+), (−,−) of both palms (section 2).

    P(++) = (1 − |κ|) p1 p2 + |κ| P, where P is min(p1, p2) in antiphase (κ > 0) and max(0, p1 + p2 − 1) in phase;
    p_i = (1 + σ_i)/2.
    """
    p1, p2 = ((1 + each) / 2 for each in sigma)
    in_antiphase, in_phase = xp.fmin(p1, p2), xp.fmax(p1 + p2 - 1, 0)
    both = p1 * p2
    both = both + xp.fmax(kappa, 0) * (in_antiphase - both) + xp.fmax(-kappa, 0) * (in_phase - both)
    return both, p1 - both, p2 - both, 1 - p1 - p2 + both


def normal_forces(
    A: Sequence[Sequence[Any]], B: Sequence[Sequence[Any]], b: Sequence[Any], friction: Sequence[Any], xp: Any = ca
) -> tuple[Any, Any]:
    """f1, f2 of (A − B diag(friction)) f = b (section 1), friction μ_i times the direction of slip at contact i.

    The determinant is that of a body which is not wedged: at least `LEAST_DETERMINANT` of the one without friction.
    """
    (m11, m12), (m21, m22) = (
        (a - c * s for a, c, s in zip(*rows, friction, strict=True)) for rows in zip(A, B, strict=True)
    )
    least = LEAST_DETERMINANT * (A[0][0] * A[1][1] - A[0][1] * A[1][0])
    determinant = xp.fmax(m11 * m22 - m12 * m21, least)
    return (b[0] * m22 - b[1] * m12) / determinant, (m11 * b[1] - m21 * b[0]) / determinant


def sign_pair_forces(
    A: Sequence[Sequence[Any]], B: Sequence[Sequence[Any]], b: Sequence[Any], mu: Sequence[Any], xp: Any = ca
) -> tuple[tuple[Any, ...], ...]:
    """f1, f2 for each of `SIGN_PAIRS` (section 1), mu of each palm; negative of a contact that would be pulled."""
    pairs = ([m * s for m, s in zip(mu, signs, strict=True)] for signs in SIGN_PAIRS)
    return tuple(normal_forces(A, B, b, friction, xp) for friction in pairs)


def effective_directions(
    forces: Sequence[Sequence[Any]], sigma: Sequence[Any], kappa: Any, transmission: Any, xp: Any = ca
) -> tuple[Any, Any]:
    """The directions with which one solve gives the averaged law: σ_i + λ (σ_eff,i − σ_i), σ_eff,i = E[s_i f_i]/E[f_i].

    Sections 1 and 3. forces: `sign_pair_forces`. sigma: mean direction of slip on each palm. A contact that would be
    pulled under a pair of signs bears nothing then, so that each direction stays within ±1.
    """
    mean, along = [LEAST_FORCE, LEAST_FORCE], [0.0, 0.0]
    for share, signs, pressed in zip(sign_shares(sigma, kappa, xp), SIGN_PAIRS, forces, strict=True):
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


def ripples(
    forces: Sequence[Sequence[Any]],
    mu: Sequence[Any],
    sigma: Sequence[Any],
    kappa: Any,
    body: SlipResponse,
    xp: Any = ca,
) -> tuple[Any, Any]:
    """By how much (m/s) the slip of each contact goes up and down as contacts reverse (section 1, validity b).

    A reversal of contact j changes α0 by Δ_j: a triangle of amplitude a_ij = |G_i Δ_j| p_j (1 − p_j)/(2f). Slip i
    reverses at the tip of its own, anywhere on an independent palm's (1/√3 of it, RMS). Palms of one frequency reverse
    about together, from one sign pair to its opposite. Returns the root mean square, interpolated for 0 < |κ| < 1.
    """
    both, one_only, two_only, none = (
        -sum(f * (d + m * s * r) for f, d, r, m, s in zip(pressed, body.d, body.r, mu, signs, strict=True)) / body.rho2
        for pressed, signs in zip(forces, SIGN_PAIRS, strict=True)
    )  # α0 of each pair, but for what all have
    lasts = [(1 - each**2) / 4 * body.half_period for each in sigma]
    own = [(both - two_only + one_only - none) / 2 * lasts[0], (both - one_only + two_only - none) / 2 * lasts[1]]
    together = xp.fmax(kappa, 0) * (both - none) ** 2 + xp.fmax(-kappa, 0) * (one_only - two_only) ** 2
    apart = 1 - xp.fabs(kappa)
    first, second = (
        xp.sqrt(turning**2 * (apart * (own[i] ** 2 + own[1 - i] ** 2 / 3) + together * lasts[i] ** 2) + LEAST_RIPPLE**2)
        for i, turning in enumerate(body.turning)
    )
    return first, second


@dataclass(frozen=True, slots=True)
class Averaged:
    """What friction does in the mean over the vibration.

    directions: of friction at each contact, with which one solve of the contact equations gives the mean forces.
    pair_forces, shares: normal forces (m/s²) and share of time of each of `SIGN_PAIRS`. transmission: λ, 0 with the
    averaged law.
    """

    directions: tuple[SX, ...]
    pair_forces: tuple[tuple[SX, ...], ...]
    shares: tuple[SX, ...]
    transmission: SX

    def least_forces(self, means: Sequence[SX]) -> tuple[SX, ...]:
        """The least force on each contact within a vibration (m/s²), of these mean forces; at 0 it hops.

        Of the sign pairs that last for more than `BRIEF` of the time.
        """
        return tuple(self._least(i, mean) for i, mean in enumerate(means))

    def _least(self, contact: int, mean: SX) -> SX:
        least = mean
        for pair, share in zip(self.pair_forces, self.shares, strict=True):
            least = ca.fmin(least, ca.if_else(share > BRIEF, pair[contact], mean))
        return mean + self.transmission * (least - mean)


def averaged(
    A: Sequence[Sequence[SX]],
    B: Sequence[Sequence[SX]],
    b: Sequence[SX],
    mu: Sequence[SX],
    slip: Sequence[SX],
    vibrated: Vibrated,
    body: SlipResponse,
) -> Averaged:
    """Friction at both contacts, of slips u_i (m/s), whichever law the vibration asks for."""
    forces = sign_pair_forces(A, B, b, mu)
    per_speed = SLOPE / vibrated.dither
    steady = [mean_direction(u * per_speed) for u in slip]
    # a ripple of V or more would stick, where the law is void
    rippled = [ca.fmin(a, 1 / per_speed) for a in ripples(forces, mu, steady, vibrated.kappa, body)]
    new = [
        (mean_direction((u + a) * per_speed) + mean_direction((u - a) * per_speed)) / 2
        for u, a in zip(slip, rippled, strict=True)
    ]
    old = [averaged_direction(u, vibrated.dither) for u in slip]
    sigma = [s + vibrated.averaged * (o - s) for s, o in zip(new, old, strict=True)]
    transmission = vibrated.transmission * (1 - vibrated.averaged)
    found = effective_directions(forces, sigma, vibrated.kappa, transmission)
    return Averaged(found, forces, sign_shares(sigma, vibrated.kappa), transmission)
