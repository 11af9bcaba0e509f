"""Support functions in real spherical harmonics, orthonormal on the unit sphere, as CasADi expressions.

h(u) = Σ c_lm Y_lm(u), l = 0…L, in the order (0,0), (1,−1), (1,0), (1,1), (2,−2), …; a negative m is the sine's.
H(x) = |x| h(x/|x|) is homogeneous of degree 1, so that ∇H(u) is the body's point with outward normal u, and ∇²H(u) has
the null vector u and the two radii of curvature. With the solid harmonics S_lm, homogeneous of degree l,
H = Σ c_lm |x|^(1−l) S_lm(x).
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from palmd.events import FloatArray
from palmd.model.contact import SX

Y00 = 1.0 / math.sqrt(4.0 * math.pi)


def count(order: int) -> int:
    """How many coefficients there are up to degree `order`."""
    return (order + 1) ** 2


def degrees(order: int) -> FloatArray:
    """The degree l of each coefficient."""
    return np.repeat(np.arange(order + 1.0), 2 * np.arange(order + 1) + 1)


def solid_harmonics(x: SX, order: int) -> SX:
    """S_lm(x) for x in R³, a column in the order of the coefficients."""
    r2 = ca.sumsqr(x)
    table: dict[tuple[int, int], SX] = {(0, 0): SX(Y00)}
    for m in range(1, order + 1):
        c, s = table[m - 1, m - 1], table.get((m - 1, 1 - m), SX(0))
        if m == 1:
            s = SX(0)
        factor = math.sqrt((2 * m + 1) / (2 * m)) * (math.sqrt(2.0) if m == 1 else 1.0)
        table[m, m] = factor * (x[0] * c - x[1] * s)
        table[m, -m] = factor * (x[0] * s + x[1] * c)
    for size in range(order + 1):
        for m in {size, -size}:
            for degree in range(size + 1, order + 1):
                a = math.sqrt((4 * degree**2 - 1) / (degree**2 - m**2))
                value = x[2] * table[degree - 1, m]
                if degree - 2 >= size:
                    b = math.sqrt(((degree - 1) ** 2 - m**2) / (4 * (degree - 1) ** 2 - 1))
                    value -= b * r2 * table[degree - 2, m]
                table[degree, m] = a * value
    return ca.vertcat(*(table[degree, m] for degree in range(order + 1) for m in range(-degree, degree + 1)))


def point_rows(u: SX, order: int) -> tuple[SX, SX]:
    """(rows (n,) with h(u) = rows·c, rows (n, 3) with ∇H(u) = rowsᵀc) for |u| = 1; right to first order beside it."""
    value = solid_harmonics(u, order)
    outside = SX(1.0 - degrees(order)) * value
    return value, ca.jacobian(value, u) + outside @ u.T


def curvature_row(u: SX, s: SX, order: int) -> SX:
    """Row (n,) with sᵀ∇²H(u)s = row·c for |u| = 1 and s ⟂ u; right to first order in turns of both and in s."""
    value = solid_harmonics(u, order)
    second = ca.jtimes(ca.jtimes(value, u, s), u, s)
    return second + SX(1.0 - degrees(order)) * value * ca.sumsqr(s)
