"""Both palms' curvature from a machined cylinder of known radius between them. Pure.

On curved palms the cylinder touches both at places that follow from φ2, R and both curvatures
(`calibration.cylinder:contacts_m`), and each pad reads counts = sign · counts_per_mm · (s − zero_mm). The nonlinearity
of counts over φ2 determines the curvatures, and the zeros as well; counts_per_mm must be known already (`palmd
calibrate pad`), because a larger scale has nearly the same effect as a less concave palm. All four unknowns are solved
together.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import approx_fprime

from palmd.calibration.cylinder import MIN_TRAVEL_M, CylinderError, contacts_m, inliers, readings
from palmd.calibration.pad_scale import slow_readings
from palmd.calibration.solving import solved
from palmd.config.pads import PadConfig
from palmd.events import Event, FloatArray
from palmd.system.mechanism import PALMS

Bools = npt.NDArray[np.bool_]

SCALE_SD = 3e-3
"""Relative 1σ of counts_per_mm that is included in the curvatures' errors: the accuracy of `palmd calibrate pad`."""
MAX_CURVATURE = 25.0
"""1/m: limit of the search."""

_MIN_START = 1e-3  # 1/m: start for flat palms, where differences would vanish
_STEPS = (1e-3, 1e-3, 1e-6, 1e-6)  # of finite differences: 1/m, m
_MAX_RESIDUAL_M = 5e-4  # standard deviation beyond which the counts do not follow any arc


@dataclass(frozen=True, slots=True)
class PadCurvature:
    """One palm: curvature (1/m, > 0 concave) and zero (mm), with 1σ; for an exact radius.

    curvature_sd includes the effect of a scale error of `SCALE_SD`. noise_mm: RMS residual of a reading.
    """

    curvature_per_m: float
    curvature_sd_per_m: float
    zero_mm: float
    zero_sd_mm: float
    noise_mm: float
    readings: int
    spoilt: int


def pad_curvatures(
    events: Iterable[Event], configs: Sequence[PadConfig], radius_m: float, believed: Sequence[float]
) -> tuple[PadCurvature, PadCurvature]:
    """Both palms; `configs` and the initial curvatures `believed` (1/m) are those the daemon ran with.

    Raises CylinderError if the readings do not suffice.
    """
    opening, s = [], []
    for number, config, found in zip(PALMS, configs, readings(events, configs), strict=True):
        angles, counts = slow_readings(number, found)
        opening.append(angles)
        s.append(config.sign * counts / config.counts_per_mm * 1e-3)  # from the pad's zero
    kept = [np.ones(len(each), dtype=np.bool_) for each in s]
    x = np.array([*(kappa or _MIN_START for kappa in believed), 0.0, 0.0])
    for _ in range(2):
        x = _solve(x, opening, s, kept, radius_m)
        residuals = _residuals(x, opening, s, radius_m)
        kept = [inliers(each, min_scale=1e-5) for each in residuals]
    for number, each, selected, angles in zip(PALMS, residuals, kept, opening, strict=True):
        travel = np.ptp(contacts_m(radius_m, angles[selected], x[:2].tolist())[number - 1])
        if travel < 0.8 * MIN_TRAVEL_M:
            raise CylinderError(f"the palms moved the cylinder by {travel * 1e3:.1f} mm only: was the plan stopped?")
        if not np.std(each[selected]) < _MAX_RESIDUAL_M:
            raise CylinderError(
                f"pad {number}'s counts do not follow a cylinder on an arc"
                f" (residual {np.std(each[selected]) * 1e3:.1f} mm): check pads.palm{number}.axis and counts_per_mm,"
                " and that nothing else lies on the pad"
            )
    return _results(x, residuals, kept, opening, s, radius_m)


def _model(x: FloatArray, opening: Sequence[FloatArray], radius_m: float) -> list[FloatArray]:
    """Reading of each pad (m from its zero) for x = (κ1, κ2, zero 1, zero 2)."""
    return [contacts_m(radius_m, each, x[:2].tolist())[i] - x[2 + i] for i, each in enumerate(opening)]


def _residuals(
    x: FloatArray, opening: Sequence[FloatArray], s: Sequence[FloatArray], radius_m: float
) -> list[FloatArray]:
    return [read - predicted for read, predicted in zip(s, _model(x, opening, radius_m), strict=True)]


def _solve(
    x: FloatArray, opening: Sequence[FloatArray], s: Sequence[FloatArray], kept: Sequence[Bools], radius_m: float
) -> FloatArray:
    selected, most = np.concatenate(kept), np.array([MAX_CURVATURE, MAX_CURVATURE, np.inf, np.inf])
    found = solved(
        lambda x: np.concatenate(_residuals(x, opening, s, radius_m))[selected], x, jac="3-point", bounds=(-most, most)
    )
    if not found.success or found.active_mask.any():
        raise CylinderError("no pair of arcs explains the readings: is the radius right, and the pads' counts_per_mm?")
    return np.asarray(found.x)


def _results(
    x: FloatArray,
    residuals: Sequence[FloatArray],
    kept: Sequence[Bools],
    opening: Sequence[FloatArray],
    s: Sequence[FloatArray],
    radius_m: float,
) -> tuple[PadCurvature, PadCurvature]:
    noise = [math.sqrt(float(np.mean(each[selected] ** 2))) for each, selected in zip(residuals, kept, strict=True)]
    gradient = approx_fprime(x, lambda x: np.concatenate(_model(x, opening, radius_m)), _STEPS)[np.concatenate(kept)]
    rows = gradient / np.repeat(noise, [selected.sum() for selected in kept])[:, None]
    covariance, shifts = np.linalg.inv(rows.T @ rows), []
    for own in range(len(PALMS)):  # a scale error changes that pad's readings in proportion
        change = [
            each[selected] * (i == own) / sd for i, (each, selected, sd) in enumerate(zip(s, kept, noise, strict=True))
        ]
        shifts.append(SCALE_SD * covariance @ (rows.T @ np.concatenate(change)))
    covariance = covariance + sum(np.outer(shift, shift) for shift in shifts)
    sd = np.sqrt(np.diag(covariance))
    one, two = (
        PadCurvature(
            float(x[i]), float(sd[i]), float(x[2 + i]) * 1e3, float(sd[2 + i]) * 1e3, noise[i] * 1e3,
            int(kept[i].sum()), int((~kept[i]).sum()),
        )
        for i in range(len(PALMS))
    )  # fmt: skip
    return one, two
