"""Both palms' curvature from a turned cylinder of known radius between them. Pure.

On palms that are arcs the cylinder touches both at places that follow from φ2, R and both curvatures
(`calibration.cylinder:contacts_m`), and each pad says counts = sign · counts_per_mm · (s − zero_mm). The bend of counts
over φ2 tells the curvatures, and the zeros beside them; what a millimetre is, a pad must know already (`palmd calibrate
pad`), for a longer one looks much like a less concave palm. By Gauss–Newton in (κ1, κ2, zero 1, zero 2) at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.calibration.cylinder import LEAST_TRAVEL_M, CylinderError, contacts_m, not_spoilt, readings
from palmd.calibration.pad_scale import slow_readings
from palmd.config.pads import PadConfig
from palmd.events import Event, FloatArray
from palmd.system.mechanism import PALMS

Bools = npt.NDArray[np.bool_]

SCALE_SD = 3e-3
"""One-sigma of counts_per_mm, as a share, that is in the curvatures' error: what `palmd calibrate pad` is good for."""
LARGEST = 25.0
"""1/m: of curvatures that are looked for."""

_ROUNDS, _SETTLED = 30, 1e-6  # 1/m
_LONGEST_STEP = 3.0  # 1/m
_NOT_FLAT = 1e-3  # 1/m: at exactly none there is no difference to go by
_STEPS = (1e-2, 1e-2, 1e-6, 1e-6)  # of the differences: 1/m, m
_LEFT_M = 5e-4  # of each reading, beyond which the counts do not follow any arc


@dataclass(frozen=True, slots=True)
class PadCurvature:
    """One palm: curvature (1/m, > 0 concave) and zero (mm), with one sigma; the radius taken for exact.

    curvature_sd has in it what a scale that is off by `SCALE_SD` does. noise_mm: left of each reading.
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
    """Both palms; `configs` are those the daemon ran with, and so are the curvatures `believed` (1/m) to begin with.

    Raises CylinderError for readings that do not suffice.
    """
    opening, s = [], []
    for number, config, found in zip(PALMS, configs, readings(events, configs), strict=True):
        angles, counts = slow_readings(number, found)
        opening.append(angles)
        s.append(config.sign * counts / config.counts_per_mm * 1e-3)  # from the pad's zero
    kept = [np.ones(len(each), dtype=np.bool_) for each in s]
    x = np.array([*(kappa or _NOT_FLAT for kappa in believed), 0.0, 0.0])
    for _ in range(2):
        x = _solved(x, opening, s, kept, radius_m)
        left = _left(x, opening, s, radius_m)
        kept = [not_spoilt(each, least=1e-5) for each in left]
    for number, each, some, angles in zip(PALMS, left, kept, opening, strict=True):
        way = np.ptp(contacts_m(radius_m, angles[some], x[:2].tolist())[number - 1])
        if way < 0.8 * LEAST_TRAVEL_M:
            raise CylinderError(f"the palms moved the cylinder by {way * 1e3:.1f} mm only: was the plan stopped?")
        if not np.std(each[some]) < _LEFT_M:
            raise CylinderError(
                f"pad {number}'s counts do not follow a cylinder on an arc ({np.std(each[some]) * 1e3:.1f} mm are left"
                f" of each): check pads.palm{number}.axis and its counts_per_mm, and that nothing else lies on the pad"
            )
    return _told(x, left, kept, opening, s, radius_m)


def _model(x: FloatArray, opening: Sequence[FloatArray], radius_m: float) -> list[FloatArray]:
    """What each pad says (m from its zero) for x = (κ1, κ2, zero 1, zero 2)."""
    return [contacts_m(radius_m, each, x[:2].tolist())[i] - x[2 + i] for i, each in enumerate(opening)]


def _left(x: FloatArray, opening: Sequence[FloatArray], s: Sequence[FloatArray], radius_m: float) -> list[FloatArray]:
    return [said - of for said, of in zip(s, _model(x, opening, radius_m), strict=True)]


def _gradient(x: FloatArray, opening: Sequence[FloatArray], radius_m: float) -> list[FloatArray]:
    columns = []
    for step, unit in zip(_STEPS, np.eye(len(x)), strict=True):
        plus, minus = (_model(x + sign * step * unit, opening, radius_m) for sign in (1.0, -1.0))
        columns.append([(a - b) / (2 * step) for a, b in zip(plus, minus, strict=True)])
    return [np.stack([column[i] for column in columns], axis=1) for i in range(len(opening))]


def _solved(
    x: FloatArray, opening: Sequence[FloatArray], s: Sequence[FloatArray], kept: Sequence[Bools], radius_m: float
) -> FloatArray:
    for _ in range(_ROUNDS):
        rows = np.concatenate([each[some] for each, some in zip(_gradient(x, opening, radius_m), kept, strict=True)])
        left = np.concatenate([each[some] for each, some in zip(_left(x, opening, s, radius_m), kept, strict=True)])
        step = np.linalg.lstsq(rows, left, rcond=None)[0]
        step *= min(1.0, _LONGEST_STEP / np.abs(step[:2]).max())
        x = x + step
        if np.abs(x[:2]).max() > LARGEST:
            break
        if np.abs(step[:2]).max() < _SETTLED:
            return np.asarray(x)
    raise CylinderError("no pair of arcs explains the readings: is the radius right, and the pads' counts_per_mm?")


def _told(
    x: FloatArray,
    left: Sequence[FloatArray],
    kept: Sequence[Bools],
    opening: Sequence[FloatArray],
    s: Sequence[FloatArray],
    radius_m: float,
) -> tuple[PadCurvature, PadCurvature]:
    noise = [math.sqrt(float(np.mean(each[some] ** 2))) for each, some in zip(left, kept, strict=True)]
    gradients = _gradient(x, opening, radius_m)
    rows = np.concatenate([each[some] / sd for each, some, sd in zip(gradients, kept, noise, strict=True)])
    covariance, shifts = np.linalg.inv(rows.T @ rows), []
    for own in range(len(PALMS)):  # a scale that is off moves that pad's readings in proportion
        moved = [each[some] * (i == own) / sd for i, (each, some, sd) in enumerate(zip(s, kept, noise, strict=True))]
        shifts.append(SCALE_SD * covariance @ (rows.T @ np.concatenate(moved)))
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
