"""Height of both pads' surfaces over the hinge line, from two machined cylinders of known radii. Pure.

A disc of radius R between flat surfaces that lie d1 and d2 above the hinge line touches palm 1 at

    s1 = ((R + d1) cos φ2 + R + d2)/sin φ2,

and palm 2 with the two exchanged: one cylinder determines the product of R + d and the pad's scale, and a second,
smaller one separates them. Besides zero, scale and standoff of each pad the fit has further parameters, with the
configured 1σ as priors: bow, displacement by the force, the palm angle φ2, and the radii. Both pads and both cylinders
are solved together.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.calibration.cylinder import CylinderError, CylinderReadings, inliers, readings
from palmd.calibration.pad_scale import PadScaleResult, is_slow, pad_scales
from palmd.calibration.solving import solved
from palmd.config.pads import PadConfig
from palmd.events import Event, FloatArray
from palmd.system.mechanism import PALMS

MIN_RATIO = 1.3
"""Smallest ratio of the radii, to distinguish scale and standoff."""
RADIUS_SD_MM = 0.01
"""1σ of a measured radius."""

_BOW_ROUNDS = 3  # iterations for the contact and the slope on a bowed pad

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class PadStandoff:
    """One pad: s = zero_mm + sign · counts/counts_per_mm, surface standoff_mm above the hinge line, on the object's
    side; with 1σ of each, which includes that of the radii.

    noise_mm: RMS residual of a reading.
    """

    sign: int
    zero_mm: float
    zero_sd_mm: float
    counts_per_mm: float
    scale_sd: float
    standoff_mm: float
    standoff_sd_mm: float
    noise_mm: float
    readings: int
    spoilt: int


@dataclass(frozen=True, slots=True)
class _Session:
    """One cylinder: radius (mm), and by pad openings (rad), counts over the nominal scale (mm), forces (N)."""

    radius_mm: float
    opening: tuple[FloatArray, ...]
    reading_mm: tuple[FloatArray, ...]
    force_n: tuple[FloatArray, ...]


class _Unknown:
    """Indices in the fit's vector; of pad i: base + i."""

    ZERO, SCALE, STANDOFF, SAGITTA, FORCE = 0, 2, 4, 6, 8  # mm, share, mm, mm, mm/N
    OPENING, RADIUS = 10, 11  # rad, mm of each cylinder
    COUNT = 13


def pad_standoffs(
    sessions: Sequence[Iterable[Event]],
    configs: Sequence[PadConfig],
    radii_m: tuple[float, float],
    opening_sd_rad: float,
) -> tuple[PadStandoff, ...]:
    """Both pads, from the events with each cylinder; `configs` are those the daemon ran with.

    Raises CylinderError if the readings do not suffice.
    """
    recorded = [list(events) for events in sessions]
    first = pad_scales(recorded[0], tuple(configs), radii_m[0])
    pad_scales(recorded[1], tuple(configs), radii_m[1])  # raises an error if the second session is unusable
    prepared = [
        _session(readings(events, configs), configs, first, radius)
        for events, radius in zip(recorded, radii_m, strict=True)
    ]
    prior_sd = _prior_sd(configs, opening_sd_rad)
    kept = [np.ones(len(each), dtype=np.bool_) for each in _readings_mm(prepared)]
    noise_mm = [pad.noise_mm for pad in first] * len(prepared)
    x, covariance = np.zeros(_Unknown.COUNT), np.zeros((_Unknown.COUNT,) * 2)
    for _ in range(2):
        x, covariance = _solve(x, prepared, configs, kept, noise_mm, prior_sd)
        residuals = _residuals(x, prepared, configs)
        kept = [inliers(each, min_scale=1e-2) for each in residuals]
        noise_mm = [max(float(np.std(each[selected])), 1e-3) for each, selected in zip(residuals, kept, strict=True)]
    return tuple(_result(i, x, np.sqrt(np.diag(covariance)), first[i], residuals, kept) for i in range(len(PALMS)))


def _session(
    found: Sequence[CylinderReadings], configs: Sequence[PadConfig], nominal: Sequence[PadScaleResult], radius_m: float
) -> _Session:
    opening, reading, force = [], [], []
    for own, config, pad in zip(found, configs, nominal, strict=True):
        selected = is_slow(own)
        pressure = own.pressure[selected]
        largest = np.nanmax(pressure, initial=0.0)  # substitute at full scale, where the pressure is unknown
        opening.append(own.opening[selected])
        reading.append(pad.sign * own.counts[selected] / pad.counts_per_mm + pad.zero_mm)
        force.append(np.where(np.isfinite(pressure), pressure, largest) * config.newtons_per_count)
    return _Session(radius_m * 1e3, tuple(opening), tuple(reading), tuple(force))


def _prior_sd(configs: Sequence[PadConfig], opening_sd_rad: float) -> FloatArray:
    """1σ of the fit's unknowns; zeros, scales and standoffs have no prior."""
    sd = np.full(_Unknown.COUNT, np.inf)
    sd[_Unknown.SAGITTA : _Unknown.FORCE] = [pad.sagitta_sd_mm for pad in configs]
    sd[_Unknown.FORCE : _Unknown.OPENING] = [pad.force_sd_mm_per_n for pad in configs]
    sd[_Unknown.OPENING] = opening_sd_rad
    sd[_Unknown.RADIUS :] = RADIUS_SD_MM
    return np.asarray(np.maximum(sd, 1e-9))


def _readings_mm(prepared: Sequence[_Session]) -> list[FloatArray]:
    return [reading for session in prepared for reading in session.reading_mm]


def _model(x: FloatArray, prepared: Sequence[_Session], configs: Sequence[PadConfig]) -> list[FloatArray]:
    """Predicted reading of each pad (mm) for each cylinder, in the order of `_readings_mm`."""
    predicted = []
    for number, session in enumerate(prepared):
        radius = session.radius_mm + x[_Unknown.RADIUS + number]
        for i, (opening, force) in enumerate(zip(session.opening, session.force_n, strict=True)):
            s = _contact_mm(x, i, radius, opening + x[_Unknown.OPENING], configs)
            predicted.append((1.0 + x[_Unknown.SCALE + i]) * s + x[_Unknown.ZERO + i] + x[_Unknown.FORCE + i] * force)
    return predicted


def _contact_mm(
    x: FloatArray, i: int, radius_mm: float, opening: FloatArray, configs: Sequence[PadConfig]
) -> FloatArray:
    """Contact of the disc with palm i + 1: a bowed pad is its tangent there, rotated and raised at the hinge."""
    other = 1 - i
    s = radius_mm / np.tan(opening / 2)
    for _ in range(_BOW_ROUNDS):
        rotation, heights = np.zeros_like(opening), []
        for pad in (i, other):
            sagitta, length = x[_Unknown.SAGITTA + pad], configs[pad].length_mm
            rotation = rotation + 4.0 * sagitta / length * (1.0 - 2.0 * s / length)
            heights.append(radius_mm + x[_Unknown.STANDOFF + pad] + 4.0 * sagitta * (s / length) ** 2)
        angle = opening - rotation
        s = (heights[0] * np.cos(angle) + heights[1]) / np.sin(angle)
    return np.asarray(s)


def _residuals(x: FloatArray, prepared: Sequence[_Session], configs: Sequence[PadConfig]) -> list[FloatArray]:
    return [
        reading - predicted
        for reading, predicted in zip(_readings_mm(prepared), _model(x, prepared, configs), strict=True)
    ]


def _solve(
    x: FloatArray,
    prepared: Sequence[_Session],
    configs: Sequence[PadConfig],
    kept: Sequence[Bools],
    noise_mm: Sequence[float],
    prior_sd: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """The unknowns and their covariance."""

    def weighted(each: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([part[selected] / sd for part, selected, sd in zip(each, kept, noise_mm, strict=True)])

    found = solved(lambda x: np.concatenate([weighted(_residuals(x, prepared, configs)), x / prior_sd]), x)
    if not found.success:
        raise CylinderError("no standoff explains the readings: check the radii and the order of the cylinders")
    return found.x, np.linalg.inv(found.jac.T @ found.jac)


def _result(
    i: int,
    x: FloatArray,
    sd: FloatArray,
    nominal: PadScaleResult,
    residuals: Sequence[FloatArray],
    kept: Sequence[Bools],
) -> PadStandoff:
    own = [
        (each, selected) for number, (each, selected) in enumerate(zip(residuals, kept, strict=True)) if number % 2 == i
    ]
    scale = 1.0 + float(x[_Unknown.SCALE + i])
    # reading = (1 + scale)·s + zero in nominal millimetres, so s = (nominal zero − zero)/(1 + scale) + counts/…
    return PadStandoff(
        sign=nominal.sign,
        zero_mm=(nominal.zero_mm - float(x[_Unknown.ZERO + i])) / scale,
        zero_sd_mm=float(sd[_Unknown.ZERO + i]),
        counts_per_mm=nominal.counts_per_mm * scale,
        scale_sd=float(sd[_Unknown.SCALE + i]),
        standoff_mm=float(x[_Unknown.STANDOFF + i]),
        standoff_sd_mm=float(sd[_Unknown.STANDOFF + i]),
        noise_mm=math.sqrt(float(np.mean(np.concatenate([each[selected] for each, selected in own]) ** 2))),
        readings=sum(int(selected.sum()) for _, selected in own),
        spoilt=sum(int((~selected).sum()) for _, selected in own),
    )
