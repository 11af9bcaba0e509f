"""Published estimates from a filter's state: estimate, outline, belief for planning. Pure, safe inside the loop."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.events import Estimate, FloatArray, PalmMotion, PlanningBelief, ShapeEstimate
from palmd.model import shape, shape_map
from palmd.model.outputs import NAMED
from palmd.observer.coverage import NORMAL_BINS, Marks
from palmd.observer.filters.base import Filters
from palmd.observer.mass import MassEstimator
from palmd.observer.outline import sd_of
from palmd.system.mechanism import FORCES, JOINT_RATES, JOINTS
from palmd.system.reasons import Code

DIRECTIONS = 180  # normals of the published outline
THETA: FloatArray = np.linspace(0.0, 2 * np.pi, DIRECTIONS, endpoint=False)
BIN_OF_THETA = (THETA / (2 * np.pi) * NORMAL_BINS).astype(np.intp)
SAMPLES, RIVALS = 6, 3  # alternative states in a planning belief, and how many of them at most are rival filters
_BINS = np.linspace(0.0, 2 * np.pi, NORMAL_BINS, endpoint=False) + np.pi / NORMAL_BINS
_SHAPE = slice(shape_map.Z.SHAPE, None)

_UNKNOWN: dict[str, Any] = dict.fromkeys((*NAMED, "mass", "nis", "observability"), math.nan)
_UNKNOWN_SD = dict.fromkeys((*NAMED, "mass"), math.nan)


def make_estimate(
    t: float, valid: bool, observer: str, object_count: int,
    y: list[float], sd: list[float], mass: MassEstimator, nis: float, observability: float, touched: float,
    invalid_reasons: tuple[str, ...],
) -> Estimate:  # fmt: skip
    """The estimate with values `y` and standard deviations `sd` of `NAMED` (SI); forces become newtons by F = m f."""
    values, sds = dict(zip(NAMED, y, strict=True)), dict(zip(NAMED, sd, strict=True))
    m, m_sd = mass.value, mass.sd
    for name in FORCES:
        f = values[name]
        values[name], sds[name] = m * f, math.hypot(m * sds[name], m_sd * f)
    sds["mass"] = m_sd
    fields = {
        "t": t, "valid": valid, "observer": observer, "object_count": object_count,
        "mass": m, "nis": nis, "observability": observability, "touched": touched, "sd": sds,
        "invalid_reasons": invalid_reasons,
    }  # fmt: skip
    return Estimate.of(fields | values)


def empty_estimate(t: float, observer: str, object_count: int, palms: PalmMotion | None) -> Estimate:
    """The estimate without an object: the palms' motion if it is known, NaN elsewhere."""
    known: dict[str, Any] = (
        {} if palms is None else dict(zip((*JOINTS, *JOINT_RATES), (*palms.angles, *palms.rates), strict=True))
    )
    return Estimate(
        t=t, valid=False, observer=observer, object_count=object_count, touched=0.0, invalid_reasons=(Code.NO_OBJECT,),
        sd=dict(_UNKNOWN_SD), **{**_UNKNOWN, **known},
    )  # fmt: skip


def outline_estimate(
    t: float, coefficients: FloatArray, cov: FloatArray, marks: Marks, inflation: float, radius_sd: float
) -> ShapeEstimate:
    """The outline on `DIRECTIONS` normals, from its coefficients (m) and their covariance (m²).

    `inflation` multiplies its standard deviation; `radius_sd` (m), an error common to all normals, is added in
    quadrature.
    """
    touched = marks[BIN_OF_THETA]
    h, d = _direction_rows(len(coefficients))
    free = shape.gauge_free_rows((h, d), (h[touched], d[touched]), coefficients)  # as `gauge_free_sd` on `THETA`
    h_sd = np.hypot(sd_of(free, cov) * inflation, radius_sd)
    return ShapeEstimate(t, THETA, h @ coefficients, h_sd, touched)


def planning_belief(
    t: float, filters: Filters, rivals: npt.NDArray[np.intp], marks: Marks, inflation: float,
    random: np.random.Generator, object_count: int, rig: FloatArray | None, mass: MassEstimator,
) -> PlanningBelief | None:  # fmt: skip
    """The best filter's state, the states of its plausible `rivals`, and samples of its posterior.

    None if the filters do not support rollouts or the covariance is not positive definite. Takes a fraction of a
    millisecond.
    """
    if not filters.supports_rollout:
        return None
    bank, best = filters.bank, filters.bank.best()
    state, P = filters.as_shape_map(best), bank.P[best]
    try:
        root = np.linalg.cholesky(P + np.diag(np.full(len(P), 1e-16)))[: shape_map.N, : shape_map.N]
    except np.linalg.LinAlgError:
        return None
    others = [member for member in rivals if member != best][:RIVALS]
    drawn = state + inflation * random.standard_normal((SAMPLES - len(others), len(state))) @ root.T
    samples = np.vstack([*(filters.as_shape_map(other) for other in others), drawn])
    for constant in (shape_map.Z.MU, shape_map.Z.DAMPING):
        samples[:, constant] = np.abs(samples[:, constant])
    outline = P[_SHAPE, _SHAPE]
    rows = bin_rows(len(outline))
    h_sd = inflation * np.sqrt(np.maximum(((rows @ outline) * rows).sum(axis=1), 0.0))
    spread = None if filters.spread is None else filters.spread[_SHAPE].copy()
    states = np.vstack([state, samples])
    return PlanningBelief(t, states, marks.copy(), h_sd, object_count, rig, spread, mass.value, mass.sd)


@cache
def _direction_rows(coefficients: int) -> tuple[FloatArray, FloatArray]:
    """Rows that map the coefficients to h and to −h′ in the published directions."""
    order = (coefficients - 1) // 2
    return shape.basis(THETA, order), shape.tangential_basis(THETA, order)


@cache
def bin_rows(coefficients: int) -> FloatArray:
    """Rows that map the coefficients to h in the middles of the bins of normals."""
    return shape.basis(_BINS, (coefficients - 1) // 2)
