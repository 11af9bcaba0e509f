"""Support functions in real spherical harmonics, orthonormal on the unit sphere, as CasADi expressions.

h(u) = Σ c_lm Y_lm(u), l = 0…L, in the order (0,0), (1,−1), (1,0), (1,1), (2,−2), …; negative m are sine terms.
H(x) = |x| h(x/|x|) is homogeneous of degree 1, so that ∇H(u) is the body's point with outward normal u, and ∇²H(u) has
the null vector u and the two radii of curvature as its other eigenvalues. With the solid harmonics S_lm, homogeneous of
degree l, H = Σ c_lm |x|^(1−l) S_lm(x).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np

from palmd.events import FloatArray
from palmd.model.symbolic import SX, ca

Y00 = 1.0 / math.sqrt(4.0 * math.pi)
DIFFERENCE_RAD = 1e-4  # step of the finite differences for second derivatives

Number = TypeVar("Number", SX, FloatArray)


def order_of(coefficients: int) -> int:
    """Degree of an outline with so many coefficients; inverse of `count`."""
    return math.isqrt(coefficients) - 1


def count(order: int) -> int:
    """Number of coefficients up to degree `order`."""
    return (order + 1) ** 2


def degrees(order: int) -> FloatArray:
    """Degree l of each coefficient."""
    return np.repeat(np.arange(order + 1.0), 2 * np.arange(order + 1) + 1)


def solid_harmonics(x: SX, order: int) -> SX:
    """S_lm(x) for x in R³, a column in the order of the coefficients."""
    return ca.vertcat(*_solid_harmonics(x, ca.sumsqr(x), SX(Y00), SX(0), order))


def _solid_harmonics(x: Number, square: Number, first: Number, zero: Number, order: int) -> list[Number]:
    table = {(0, 0): first}
    for m in range(1, order + 1):
        c, s = table[m - 1, m - 1], table.get((m - 1, 1 - m), zero)
        if m == 1:
            s = zero
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
                    value -= b * square * table[degree - 2, m]
                table[degree, m] = a * value
    return [table[degree, m] for degree in range(order + 1) for m in range(-degree, degree + 1)]


@cache
def derivatives(order: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Dx, Dy, Dz (n, n) with ∂S/∂xᵢ = Dᵢ S; a derivative of degree l is a sum of at most two of degree l − 1."""
    x = SX.sym("x", 3)
    value = solid_harmonics(x, order)
    points = np.random.default_rng(0).normal(size=(4 * order + 8, 3))  # arbitrary points: the fit is exact
    at, slope = ca.Function("S", [x], [value, ca.jacobian(value, x)]).map(len(points))(points.T)
    S, n = np.asarray(at), count(order)
    slopes = np.asarray(slope).reshape(n, len(points), 3)
    matrices = np.zeros((3, n, n))
    for degree in range(1, order + 1):
        above, below = slice(degree**2, (degree + 1) ** 2), slice((degree - 1) ** 2, degree**2)
        for i in range(3):
            matrices[i, above, below] = np.linalg.lstsq(S[below].T, slopes[above, :, i].T, rcond=None)[0].T
    matrices[np.abs(matrices) < 1e-9] = 0.0
    return matrices[0], matrices[1], matrices[2]


def evaluator(order: int) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """Function that maps unit normals (T, 3) to rows of h (T, n) and of the surface point ∇H (T, 3, n)."""
    outside, slopes = 1.0 - degrees(order), [each.T for each in derivatives(order)]

    def rows(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        first, zero = np.full(len(u), Y00), np.zeros(len(u))
        S = np.stack(_solid_harmonics(u.T, (u**2).sum(axis=1), first, zero, order), axis=1)
        level = outside * S
        return S, np.stack([S @ slope + u[:, i, None] * level for i, slope in enumerate(slopes)], axis=1)

    return rows


def hessian_rows(order: int, u: FloatArray) -> FloatArray:
    """(T, 2, 2, n) rows of ∇²H in two axes normal to each unit normal u (T, 3).

    By finite differences, so that it is symmetric to their accuracy only.
    """
    rows = evaluator(order)
    one = np.cross(u, np.eye(3)[np.abs(u).argmin(axis=1)])
    one /= np.linalg.norm(one, axis=1)[:, None]
    axes = np.stack([one, np.cross(u, one)])
    slopes = []
    for axis in axes:
        ahead, behind = (u + sign * DIFFERENCE_RAD * axis for sign in (1.0, -1.0))
        ends = [each / np.linalg.norm(each, axis=1)[:, None] for each in (ahead, behind)]
        slopes.append((rows(ends[0])[1] - rows(ends[1])[1]) / (2.0 * DIFFERENCE_RAD))
    return np.stack([np.stack([np.einsum("di,din->dn", axis, slope) for slope in slopes], 1) for axis in axes], 1)


@dataclass(frozen=True, slots=True)
class SphericalSurface:
    """A body's surface at the outward unit normal u, with coefficients c (n,); columns of CasADi expressions.

    Derivatives by u hold for rotations of u (and s), not for changes of its length. Quantities linear in c also come as
    rows, with value rows·c.
    """

    u: SX
    c: SX
    order: int

    @property
    def harmonics(self) -> SX:
        """Rows (n,) of h: the harmonics at u."""
        return solid_harmonics(self.u, self.order)

    def terms(self) -> HarmonicTerms:
        """Terms that `point` and `curvature` share."""
        S = self.harmonics
        D = [ca.sparsify(ca.DM(matrix)) for matrix in derivatives(self.order)]
        G = [each @ S for each in D]
        outside = ca.DM(1.0 - degrees(self.order))
        scaled = outside * self.c
        return HarmonicTerms(
            D, S, G, [each.T @ self.c for each in D], outside * S, ca.dot(scaled, S), [ca.dot(scaled, g) for g in G]
        )


@dataclass(frozen=True, slots=True)
class HarmonicTerms:
    """D: derivative matrices; S: harmonics; G: D S; c_slopes: Dᵀc; outside: (1 − l)S; level: its product with c."""

    D: list[ca.DM]
    S: SX
    G: list[SX]
    c_slopes: list[SX]
    outside: SX
    level: SX
    level_slopes: list[SX]


def point(surface: SphericalSurface, terms: HarmonicTerms) -> tuple[SX, SX, SX]:
    """(x = ∇H(u), ∂x/∂u (3, 3), its rows (3, n))."""
    u = surface.u
    rows = ca.vertcat(*((g + terms.outside * u[i]).T for i, g in enumerate(terms.G)))
    return rows @ surface.c, _hessian(terms) + u @ ca.horzcat(*terms.level_slopes), rows


def curvature(surface: SphericalSurface, terms: HarmonicTerms, s: SX) -> tuple[SX, SX, SX, SX]:
    """(κ = sᵀ∇²H(u)s for s ⟂ u, ∂κ/∂u (1, 3), ∂κ/∂s (1, 3), its rows (1, n))."""
    along = sum((s[i] * g for i, g in enumerate(terms.G)), SX(0))
    twice = sum((s[i] * (d @ along) for i, d in enumerate(terms.D)), SX(0))
    square = ca.sumsqr(s)
    rows = (twice + terms.outside * square).T
    by_u = ca.horzcat(
        *(ca.dot(c, twice) + square * slope for c, slope in zip(terms.c_slopes, terms.level_slopes, strict=True))
    )
    return rows @ surface.c, by_u, 2 * (_hessian(terms) @ s).T, rows


def _hessian(terms: HarmonicTerms) -> SX:
    """∇²H on the plane ⟂ u."""
    second = ca.vertcat(*(ca.horzcat(*(ca.dot(c, g) for g in terms.G)) for c in terms.c_slopes))
    return second + terms.level * SX.eye(3)
