"""Shape classification: the simple shape that explains an outline, with its sizes, or none of them. Pure.

With h the support function where it was touched and C its covariance, the likelihood of a shape f(p) is that of the
Gaussian N(h; f(p), N), N = C + S, integrated over its parameters by Laplace's method; S is the smooth deviation of real
objects from their shape. "None of these" is a rival like the others: any smooth outline, a Gaussian too. A shape is
reported when it is much likelier than all rivals that look different, agrees with the outline by χ², and enough of the
outline was touched: half of an L-profile is half of a rectangle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from palmd.aliases import SHAPE_CLASS, with_former_names
from palmd.events import FloatArray
from palmd.model.shape import basis, prior_sd
from palmd.observer.primitives import PRIMITIVES, Primitive

ORDER = 12  # harmonics of a shape's deviation
FORM_SD_M = 20e-6  # 1σ of the deviation of real objects from their shape, at each normal
ROUGH_SD_M = 5e-6  # 1σ of what no smooth deviation explains
LEAST_TOUCHED = 2 / 3  # of the normals
ENOUGH = 0.99  # probability from which a shape is reported
CHI2_SIGMAS = 3.0
SAME_M = 50e-6  # largest difference of two shapes that look the same: a square is a rectangle too
MOST_SIZE_SD = 0.02  # 1σ of a size, relative to the shape, beyond which no shape is reported
EVERY = 3  # touched normals per normal used: outlines of few harmonics hardly change in between
# prior of a smooth outline's radius, and of a shape's centre about the centre of mass
SIZE_SD_M, CENTRE_SD_M = 10e-3, 3e-3
TURN_RAD, STARTS = math.radians(7.5), 2
STEP, SMALL_GAIN, MOST_DAMPING, TINY = 1e-6, 1e-4, 1e9, 1e-12


@dataclass(frozen=True, slots=True)
class Size:
    """A dimension of a shape as a person would measure it, with its 1σ (m)."""

    name: str
    value_m: float
    sd_m: float


@dataclass(frozen=True, slots=True)
class ShapeClass:
    """The shape of an outline. `name` is empty where it is none of the shapes or undecided; `why` gives the reason.

    sizes: of the reported shape. turn_rad: the smallest turn after which it looks the same, 0: any turn, so that it has
    no orientation, NaN: no shape is reported. chi2, dof: of the best shape. probabilities: of each shape and of "none
    of these", the likeliest first.
    """

    name: str = ""
    why: str = ""
    sizes: tuple[Size, ...] = ()
    turn_rad: float = math.nan
    chi2: float = math.nan
    dof: float = math.nan
    probabilities: tuple[tuple[str, float], ...] = field(default=())

    @property
    def text(self) -> str:
        """One phrase for people; empty where no shape is reported."""
        if not self.name:
            return ""
        sizes = ", ".join(f"{1e3 * s.value_m:.2f} ± {1e3 * s.sd_m:.2f} mm {s.name}" for s in self.sizes)
        unknown = "; its orientation is undetermined" if self.turn_rad == 0.0 else ""
        return f"{self.name}, {sizes}{unknown}"


NONE = "none of these"
UNCLASSIFIED = ShapeClass()


def root_of(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """A factor (n, k) of the covariance of h = rows·c for rows (n, k) and the `covariance` (k, k) of c."""
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = rows @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return root


def root_of_band(h_sd: FloatArray, theta: FloatArray) -> FloatArray:
    """A factor (n, k) of the covariance of h where only its 1σ (n) is known: h_sd times a smooth unit error."""
    return h_sd[:, None] * _smooth(theta)


def shape_class(theta: FloatArray, h: FloatArray, root: FloatArray, touched: npt.NDArray[np.bool_]) -> ShapeClass:
    """Classify the outline with support function h (m) on normals theta (rad), by the part `touched`.

    Its covariance is root·rootᵀ (n, k).
    """
    if touched.mean() < LEAST_TOUCHED:
        return ShapeClass(why=f"{touched.mean():.0%} of the normals were touched; {LEAST_TOUCHED:.0%} are needed")
    all_theta, used = theta, np.flatnonzero(touched)[::EVERY]
    theta, h = theta[used], h[used]
    spread = np.hstack([root[used], FORM_SD_M * _smooth(theta)])
    noise = spread @ spread.T + ROUGH_SD_M**2 * np.eye(len(h))
    white = np.linalg.inv(np.linalg.cholesky(noise))
    dof = float(np.trace(np.linalg.solve(noise, spread @ spread.T)))
    radius = float(np.mean(h))
    fits = [_fitted(form, theta, h, white) for form in PRIMITIVES]
    best = max(fits, key=lambda fit: fit.evidence)
    evidence = {fit.form.name: fit.evidence for fit in fits} | {
        NONE: _evidence_of_smooth_outlines(theta, h, noise, radius)
    }
    largest = max(evidence.values())
    weights = {name: math.exp(value - largest) for name, value in evidence.items()}
    total = sum(weights.values())
    ranked = tuple(sorted(((name, w / total) for name, w in weights.items()), key=lambda each: -each[1]))
    same_looking = [fit.form.name for fit in fits if np.abs(fit.h(all_theta) - best.h(all_theta)).max() < SAME_M]
    free = dof - len(best.p)
    consistent = best.chi2 < free + CHI2_SIGMAS * math.sqrt(2.0 * max(free, 1.0))
    sharp = all(size.sd_m < MOST_SIZE_SD * best.p[0] for size in best.sizes)
    likeliest = sum(weights[name] for name in same_looking) > ENOUGH * total
    if ranked[0][0] == NONE or not consistent:
        why = NONE
    elif not (likeliest and sharp):
        why = (
            "its size is not known well enough" if likeliest else f"undecided between {ranked[0][0]} and {ranked[1][0]}"
        )
    else:
        return ShapeClass(best.form.name, "", best.sizes, best.form.period_rad, best.chi2, free, ranked)
    return ShapeClass(why=why, chi2=best.chi2, dof=free, probabilities=ranked)


@dataclass(frozen=True, slots=True)
class _Fit:
    """A shape with its lengths, x and y of its centre (m), and its turn (rad) unless it looks the same at any."""

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
        measured = [Size(name, factor * float(self.p[i]), factor * float(sd[i])) for name, i, factor in self.form.sizes]
        return tuple(measured)


def _fitted(form: Primitive, theta: FloatArray, h: FloatArray, white: FloatArray) -> _Fit:
    """The likeliest parameters: linear fits at a grid of turns, the best of which are iterated."""
    turns = np.arange(0.0, form.period_rad, TURN_RAD) if form.period_rad else [0.0]
    starts = [_at_turn(form, theta, h, white, float(turn)) for turn in turns]
    starts.sort(key=lambda start: start[1])
    p, chi2 = min((_iterated(form, theta, h, white, start) for start, _ in starts[:STARTS]), key=lambda each: each[1])
    J = white @ _slopes(form, theta, p)
    information = J.T @ J
    prior = np.array([*form.sd, CENTRE_SD_M, CENTRE_SD_M, form.period_rad / math.sqrt(12.0)])[: len(p)]
    posterior_information = np.eye(len(p)) + prior[:, None] * information * prior
    evidence = -0.5 * (chi2 + float(np.linalg.slogdet(posterior_information)[1])) + float(
        np.log(np.diagonal(white)).sum()
    )
    covariance = np.asarray(np.linalg.inv(information + np.diag(prior**-2.0)), dtype=np.float64)
    return _Fit(form, p, covariance, chi2, evidence)


def _at_turn(
    form: Primitive, theta: FloatArray, h: FloatArray, white: FloatArray, turn: float
) -> tuple[FloatArray, float]:
    """The likeliest lengths and centre at a turn (rad), in the linear approximation, and their χ²."""
    rows = white @ np.column_stack([form.linear(theta, turn), np.cos(theta), np.sin(theta)])
    p = np.linalg.lstsq(rows, white @ h, rcond=None)[0]
    p[:-2] = form.nearest(p[:-2])
    p = np.append(p, turn) if form.period_rad else p
    residual = white @ (h - _model(form, theta, p))
    return p, float(residual @ residual)


def _iterated(
    form: Primitive, theta: FloatArray, h: FloatArray, white: FloatArray, p: FloatArray
) -> tuple[FloatArray, float]:
    """Levenberg–Marquardt from p on: parameters and χ²."""
    residual = white @ (h - _model(form, theta, p))
    cost, damping = float(residual @ residual), 1e-3
    while damping < MOST_DAMPING:
        J = white @ _slopes(form, theta, p)
        information, pull = J.T @ J, J.T @ residual
        trial = p + np.linalg.solve(information + damping * np.diag(np.diagonal(information) + TINY), pull)
        trial[: len(form.sd)] = form.nearest(trial[: len(form.sd)])
        trial_residual = white @ (h - _model(form, theta, trial))
        trial_cost = float(trial_residual @ trial_residual)
        if trial_cost < cost:
            gain, p, residual, cost, damping = cost - trial_cost, trial, trial_residual, trial_cost, damping / 5
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
        after, before = p.copy(), p.copy()
        after[i], before[i] = p[i] + STEP, p[i] - STEP
        columns.append((_model(form, theta, after) - _model(form, theta, before)) / (2 * STEP))
    return np.stack(columns, axis=1)


def _evidence_of_smooth_outlines(theta: FloatArray, h: FloatArray, noise: FloatArray, radius: float) -> float:
    """Log evidence of any smooth outline of about this radius, up to the constant that is omitted for shapes too."""
    sd = prior_sd(radius, ORDER)
    sd[0] = SIZE_SD_M
    rows = basis(theta, ORDER) * sd
    root = np.linalg.cholesky(rows @ rows.T + noise)
    residual = np.linalg.solve(root, h - radius)
    return -0.5 * float(residual @ residual) - float(np.log(np.diagonal(root)).sum())


def _smooth(theta: FloatArray) -> FloatArray:
    """Rows whose products are the covariance of a smooth error of unit variance at each normal."""
    rows: FloatArray = basis(theta, ORDER) / math.sqrt(ORDER + 1)
    return rows


def as_json(shape: ShapeClass) -> dict[str, object]:
    """The classification for results; lengths in m."""
    fields = {
        "name": shape.name or None,
        "text": shape.text or None,
        "why": shape.why or None,
        "sizes": [{"name": s.name, "value_m": s.value_m, "sd_m": s.sd_m} for s in shape.sizes],
        "orientation_determined": None if not shape.name else shape.turn_rad > 0.0,
        "chi2": shape.chi2 if math.isfinite(shape.chi2) else None,
        "dof": shape.dof if math.isfinite(shape.dof) else None,
        "probabilities": dict(_rounded(shape.probabilities)),
    }
    return with_former_names(SHAPE_CLASS, fields)


def _rounded(probabilities: tuple[tuple[str, float], ...]) -> list[tuple[str, float]]:
    return [(name, round(value, 6)) for name, value in probabilities]
