"""Mean and covariance of the direction of dry friction in the plane of a palm that vibrates along one direction.

At slip u a point of the body moves along ŝ = (u + V cos τ·e)/|u + V cos τ·e| over the palm, which vibrates along e with
amplitude V of its speed. Means over τ are closed: σ by complete elliptic integrals (Bulirsch's cel), second moments by
square roots. Friction is −μ(σ + λμΣk) of the normal force (docs/theory/vibration.md): Σ = Cov ŝ, k the normal force's
response to friction. Each function takes CasADi expressions, or NumPy arrays if `xp` is numpy. Safe inside the loop.
"""

from __future__ import annotations

import math
from typing import Any

from palmd.model.symbolic import ca

KINK = 0.02
"""ε: |u| is replaced by √(u² + (εV)²), so that the direction does not jump where the slip reverses."""
_HALVINGS = 4  # of the arithmetic-geometric mean: with `KINK` its relative error is 1e-9


def direction_moments(along: Any, across: Any, xp: Any = ca) -> tuple[tuple[Any, Any], tuple[Any, Any, Any]]:
    """Return ((σ∥, σ⊥), (Σ∥∥, Σ∥⊥, Σ⊥⊥)) for the slip along e and across it, in units of V.

    With t = u∥/V + cos τ and Y² = (u⊥/V)² + ε² the means are, for P = √(y² + 4Y²), y = x² + Y² − 1, S² = (y + P)/2 and
    C² = S² + 1: σ∥ = (2x/π√P) cel(k', C²/P, 1, k'²) and σ⊥ = (2u⊥/πV√P) K, k'² = S²/P.
    """
    x, Y2 = along, across**2 + KINK**2
    y = x**2 + Y2 - 1.0
    product = xp.sqrt(y**2 + 4.0 * Y2)
    S2 = (y + product) / 2.0
    C2 = S2 + 1.0
    third, first = _elliptic(S2 / product, C2 / product, xp)
    scale = 1.0 / xp.sqrt(product)
    sigma = x * scale * third, across * scale * first
    ratio = xp.sqrt(C2 / S2)
    spread = ratio / product
    moments = 1.0 - Y2 * spread, across * x / (ratio * product), across**2 * spread
    return sigma, (moments[0] - sigma[0] ** 2, moments[1] - sigma[0] * sigma[1], moments[2] - sigma[1] ** 2)


def _elliptic(kc2: Any, p: Any, xp: Any) -> tuple[Any, Any]:
    """(2/π)(cel(k', p, 1, k'²), K), by one iteration for both (Bulirsch 1969), for `kc2` = k'² > 0 and p > 0."""
    e = kc = xp.sqrt(kc2)
    mean: Any = 1.0
    p = xp.sqrt(p)
    a, b = 1.0, kc2 / p
    for halving in range(_HALVINGS):
        if halving:
            kc = 2.0 * xp.sqrt(e)
            e = kc * mean
        g = e / p
        a, b = a + b / p, 2.0 * (b + a * g)
        p = p + g
        mean = mean + kc
    return (b + a * mean) / (mean * (mean + p)), 2.0**_HALVINGS / mean


def averaged_direction(along: Any, across: Any, xp: Any = ca) -> tuple[Any, Any]:
    """σ = u/√(u² + u_d²), u_d = πV/2, for the slip in units of V: the former law, for logs simulated with it."""
    size = xp.sqrt(along**2 + across**2 + (math.pi / 2.0) ** 2)
    return along / size, across / size
