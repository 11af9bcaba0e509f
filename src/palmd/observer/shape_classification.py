"""What an outline looks like: the one of a few simple forms that explains it, with its sizes, or none of them. Pure.

With h the support function where it was touched and C its covariance, a form f(p) is as likely as the Gaussian
N(h; f(p), N), N = C + S, integrated over its parameters by Laplace's method; S allows for what real things are off
their form by, smoothly. "None of these" is a rival like the others: any smooth lump, a Gaussian too. A form is told
when it is much likelier than all rivals that look different, is in accord with the outline by χ², and enough of the
outline was felt: half of an L-profile is half of a rectangle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.shape import basis, prior_sd
from palmd.observer.primitives import PRIMITIVES, Primitive

ORDER = 12  # harmonics of what a form is off by
FORM_SD_M = 20e-6  # one-sigma of what real things are off from their form, at each normal
ROUGH_SD_M = 5e-6  # and of what no smooth error explains
LEAST_FELT = 2 / 3  # of the normals
ENOUGH = 0.99  # of the probability, from which on a form is told
CHI2_SIGMAS = 3.0
SAME_M = 50e-6  # largest difference of two forms that look the same: a square is a rectangle too
MOST_SIZE_SD = 0.02  # of a size, relative to the form: whose size is not known better has no name
EVERY = 3  # of the normals touched: what an outline of few harmonics is at one, it is at the next
SIZE_SD_M, CENTRE_SD_M = 10e-3, 3e-3  # of a lump, and of a form's centre about the centre of mass
TURN_RAD, STARTS = math.radians(7.5), 2
STEP, SMALL_GAIN, MOST_DAMPING, TINY = 1e-6, 1e-4, 1e9, 1e-12


@dataclass(frozen=True, slots=True)
class Size:
    """A length of a form as a person would measure it, with its one-sigma (m)."""

    name: str
    value_m: float
    sd_m: float


@dataclass(frozen=True, slots=True)
class ShapeClass:
    """What an outline looks like. `name` is empty where it is none of the forms, or cannot be told: `why` says which.

    sizes: of the form that is told. turn_rad: the smallest turn after which it looks the same, 0: any turn, so that
    its orientation cannot be told, NaN: none is told. chi2, dof: of the form that explains it best. probabilities: of
    each form, and of "none of these", the likeliest first.
    """

    name: str = ""
    why: str = ""
    sizes: tuple[Size, ...] = ()
    turn_rad: float = math.nan
    chi2: float = math.nan
    dof: float = math.nan
    probabilities: tuple[tuple[str, float], ...] = field(default=())

    @property
    def said(self) -> str:
        """One phrase for people; empty where no form is told."""
        if not self.name:
            return ""
        sizes = ", ".join(f"{1e3 * s.value_m:.2f} ± {1e3 * s.sd_m:.2f} mm {s.name}" for s in self.sizes)
        unknown = "; its orientation cannot be told" if self.turn_rad == 0.0 else ""
        return f"{self.name}, {sizes}{unknown}"


NONE = "none of these"
UNTOLD = ShapeClass()


def root_of(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """A factor (n, k) of the covariance of h = rows·c (n, k), c's being `covariance` (k, k)."""
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = rows @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return root


def root_of_band(h_sd: FloatArray, theta: FloatArray) -> FloatArray:
    """A factor (n, k) of the covariance of h where only its one-sigma (n) is known: h_sd times a smooth unit error."""
    return h_sd[:, None] * _smooth(theta)


def shape_class(theta: FloatArray, h: FloatArray, root: FloatArray, touched: npt.NDArray[np.bool_]) -> ShapeClass:
    """What an outline of support function h (m) on normals theta (rad) looks like, by what was `touched` of it.

    Its covariance is root·rootᵀ (n, k).
    """
    if touched.mean() < LEAST_FELT:
        return ShapeClass(why=f"{touched.mean():.0%} of the normals were felt, and a name takes {LEAST_FELT:.0%}")
    everywhere, at = theta, np.flatnonzero(touched)[::EVERY]
    theta, h = theta[at], h[at]
    spread = np.hstack([root[at], FORM_SD_M * _smooth(theta)])
    noise = spread @ spread.T + ROUGH_SD_M**2 * np.eye(len(h))
    white = np.linalg.inv(np.linalg.cholesky(noise))
    dof = float(np.trace(np.linalg.solve(noise, spread @ spread.T)))
    radius = float(np.mean(h))
    fits = [_fitted(form, theta, h, white) for form in PRIMITIVES]
    best = max(fits, key=lambda fit: fit.evidence)
    evidence = {fit.form.name: fit.evidence for fit in fits} | {NONE: _evidence_of_lumps(theta, h, noise, radius)}
    most = max(evidence.values())
    weights = {name: math.exp(value - most) for name, value in evidence.items()}
    total = sum(weights.values())
    ranked = tuple(sorted(((name, w / total) for name, w in weights.items()), key=lambda each: -each[1]))
    alike = [fit.form.name for fit in fits if np.abs(fit.h(everywhere) - best.h(everywhere)).max() < SAME_M]
    free = dof - len(best.p)
    consistent = best.chi2 < free + CHI2_SIGMAS * math.sqrt(2.0 * max(free, 1.0))
    sharp = all(size.sd_m < MOST_SIZE_SD * best.p[0] for size in best.sizes)
    likeliest = sum(weights[name] for name in alike) > ENOUGH * total
    if ranked[0][0] == NONE or not consistent:
        why = NONE
    elif not (likeliest and sharp):
        why = "its size is not known well enough" if likeliest else f"not told apart: {ranked[0][0]}, {ranked[1][0]}"
    else:
        return ShapeClass(best.form.name, "", best.sizes, best.form.period_rad, best.chi2, free, ranked)
    return ShapeClass(why=why, chi2=best.chi2, dof=free, probabilities=ranked)


@dataclass(frozen=True, slots=True)
class _Fit:
    """A form with its lengths, the x and y of its centre (m), and its turn (rad) unless it is the same at any."""

    form: Primitive
    p: FloatArray
    covariance: FloatArray
    chi2: float
    evidence: float

    def h(self, theta: FloatArray) -> FloatArray:
        """Its support function about the centre of mass (m)."""
        return _model(self.form, theta, self.p)

    @property
    def sizes(self) -> tuple[Size, ...]:
        sd = np.sqrt(np.diagonal(self.covariance))
        told = [Size(name, factor * float(self.p[i]), factor * float(sd[i])) for name, i, factor in self.form.sizes]
        return tuple(told)


def _fitted(form: Primitive, theta: FloatArray, h: FloatArray, white: FloatArray) -> _Fit:
    """The likeliest parameters: a turn for turn, where the rest is linear, the best of which are iterated."""
    turns = np.arange(0.0, form.period_rad, TURN_RAD) if form.period_rad else [0.0]
    starts = [_at_turn(form, theta, h, white, float(turn)) for turn in turns]
    starts.sort(key=lambda start: start[1])
    p, chi2 = min((_iterated(form, theta, h, white, start) for start, _ in starts[:STARTS]), key=lambda each: each[1])
    J = white @ _slopes(form, theta, p)
    information = J.T @ J
    prior = np.array([*form.sd, CENTRE_SD_M, CENTRE_SD_M, form.period_rad / math.sqrt(12.0)])[: len(p)]
    told = np.eye(len(p)) + prior[:, None] * information * prior
    evidence = -0.5 * (chi2 + float(np.linalg.slogdet(told)[1])) + float(np.log(np.diagonal(white)).sum())
    covariance = np.asarray(np.linalg.inv(information + np.diag(prior**-2.0)), dtype=np.float64)
    return _Fit(form, p, covariance, chi2, evidence)


def _at_turn(
    form: Primitive, theta: FloatArray, h: FloatArray, white: FloatArray, turn: float
) -> tuple[FloatArray, float]:
    """The likeliest lengths and centre at a turn (rad), as far as they are linear, and their χ²."""
    rows = white @ np.column_stack([form.linear(theta, turn), np.cos(theta), np.sin(theta)])
    p = np.linalg.lstsq(rows, white @ h, rcond=None)[0]
    p[:-2] = form.nearest(p[:-2])
    p = np.append(p, turn) if form.period_rad else p
    miss = white @ (h - _model(form, theta, p))
    return p, float(miss @ miss)


def _iterated(
    form: Primitive, theta: FloatArray, h: FloatArray, white: FloatArray, p: FloatArray
) -> tuple[FloatArray, float]:
    """Levenberg's and Marquardt's least squares from p on: parameters and χ²."""
    miss = white @ (h - _model(form, theta, p))
    cost, damping = float(miss @ miss), 1e-3
    while damping < MOST_DAMPING:
        J = white @ _slopes(form, theta, p)
        information, pull = J.T @ J, J.T @ miss
        there = p + np.linalg.solve(information + damping * np.diag(np.diagonal(information) + TINY), pull)
        there[: len(form.sd)] = form.nearest(there[: len(form.sd)])
        missed = white @ (h - _model(form, theta, there))
        now = float(missed @ missed)
        if now < cost:
            gain, p, miss, cost, damping = cost - now, there, missed, now, damping / 5
            if gain < SMALL_GAIN:
                break
        else:
            damping *= 4
    return p, cost


def _model(form: Primitive, theta: FloatArray, p: FloatArray) -> FloatArray:
    count = len(form.sd)
    turn = float(p[-1]) if form.period_rad else 0.0
    h: FloatArray = form.support(theta, p[:count], turn) + p[count] * np.cos(theta) + p[count + 1] * np.sin(theta)
    return h


def _slopes(form: Primitive, theta: FloatArray, p: FloatArray) -> FloatArray:
    columns = []
    for i in range(len(p)):
        there, back = p.copy(), p.copy()
        there[i], back[i] = p[i] + STEP, p[i] - STEP
        columns.append((_model(form, theta, there) - _model(form, theta, back)) / (2 * STEP))
    return np.stack(columns, axis=1)


def _evidence_of_lumps(theta: FloatArray, h: FloatArray, noise: FloatArray, radius: float) -> float:
    """Of any smooth lump of about this radius, up to the constant that forms leave out too."""
    sd = prior_sd(radius, ORDER)
    sd[0] = SIZE_SD_M
    rows = basis(theta, ORDER) * sd
    root = np.linalg.cholesky(rows @ rows.T + noise)
    miss = np.linalg.solve(root, h - radius)
    return -0.5 * float(miss @ miss) - float(np.log(np.diagonal(root)).sum())


def _smooth(theta: FloatArray) -> FloatArray:
    """Rows whose products are the covariance of a smooth error of unit variance at each normal."""
    rows: FloatArray = basis(theta, ORDER) / math.sqrt(ORDER + 1)
    return rows


def as_json(told: ShapeClass) -> dict[str, object]:
    """For results: lengths in m."""
    return {
        "name": told.name or None,
        "said": told.said or None,
        "why": told.why or None,
        "sizes": [{"name": s.name, "value_m": s.value_m, "sd_m": s.sd_m} for s in told.sizes],
        "orientation_told": None if not told.name else told.turn_rad > 0.0,
        "chi2": told.chi2 if math.isfinite(told.chi2) else None,
        "dof": told.dof if math.isfinite(told.dof) else None,
        "probabilities": dict(_rounded(told.probabilities)),
    }


def _rounded(probabilities: tuple[tuple[str, float], ...]) -> list[tuple[str, float]]:
    return [(name, round(value, 6)) for name, value in probabilities]
