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


def effective_directions(
    A: Sequence[Sequence[Any]],
    B: Sequence[Sequence[Any]],
    b: Sequence[Any],
    mu: Sequence[Any],
    sigma: Sequence[Any],
    kappa: Any,
    transmission: Any,
    xp: Any = ca,
) -> tuple[Any, Any]:
    """The directions with which one solve gives the averaged law: σ_i + λ (σ_eff,i − σ_i), σ_eff,i = E[s_i f_i]/E[f_i].

    Sections 1 and 3. mu: μ of each palm; sigma: mean direction of slip on each. A contact that would be pulled under a
    pair of signs bears nothing then, so that each direction stays within ±1.
    """
    shares = sign_shares(sigma, kappa, xp)
    mean, along = [LEAST_FORCE, LEAST_FORCE], [0.0, 0.0]
    for share, signs in zip(shares, ((1, 1), (1, -1), (-1, 1), (-1, -1)), strict=True):
        forces = normal_forces(A, B, b, [m * s for m, s in zip(mu, signs, strict=True)], xp)
        for i, (force, sign) in enumerate(zip(forces, signs, strict=True)):
            part = share * xp.fmax(force, 0)
            mean[i], along[i] = mean[i] + part, along[i] + sign * part
    one, two = (s + transmission * (a / m - s) for s, a, m in zip(sigma, along, mean, strict=True))
    return one, two


def directions(
    A: Sequence[Sequence[SX]],
    B: Sequence[Sequence[SX]],
    b: Sequence[SX],
    mu: Sequence[SX],
    slip: Sequence[SX],
    vibrated: Vibrated,
) -> tuple[SX, SX]:
    """The direction of friction at each contact, of slips u_i (m/s), whichever law the vibration asks for."""
    old = [averaged_direction(u, vibrated.dither) for u in slip]
    new = [mean_direction(SLOPE * u / vibrated.dither) for u in slip]
    sigma = [s + vibrated.averaged * (o - s) for s, o in zip(new, old, strict=True)]
    return effective_directions(A, B, b, mu, sigma, vibrated.kappa, vibrated.transmission * (1 - vibrated.averaged))
