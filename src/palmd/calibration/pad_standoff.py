"""How high both pads' surfaces lie above the hinge line, from two turned cylinders of known radii. Pure.

A disc of radius R between flat surfaces that lie d1 and d2 above the hinge line touches palm 1 at

    s1 = ((R + d1) cos φ2 + R + d2)/sin φ2,

and palm 2 with the two exchanged: what one cylinder tells is R + d times the pad's scale, and a second, smaller one
tells them apart. Beside zero, scale and standoff of each pad the fit has what else moves a reading, held by the
configured one-sigmas: bow, how it moves with the force, the palm angle φ2, and how well the radii are measured. By
Gauss–Newton over both pads and both cylinders at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.calibration.cylinder import CylinderError, CylinderReadings, not_spoilt, readings
from palmd.calibration.pad_scale import PadScale, pad_scales, slow_enough
from palmd.config.pads import PadConfig
from palmd.events import Event, FloatArray
from palmd.system.mechanism import PALMS

LEAST_RATIO = 1.3
"""Of the radii, for the scale and the standoff to be told apart."""
RADIUS_SD_MM = 0.01
"""How well a radius is measured, one-sigma."""

_ROUNDS, _SETTLED_MM = 20, 1e-7
_STEP = 1e-4  # of the differences, in mm, shares, rad
_BOWS = 3  # rounds until the place on a bowed pad and its slope there agree

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class PadStandoff:
    """One pad: s = zero_mm + sign · counts/counts_per_mm, surface standoff_mm above the hinge line, on the object's
    side; with one sigma of each, which has the radii's in it.

    noise_mm: what is left of a reading, one sigma.
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
    """One cylinder: its radius (mm), and of each pad openings (rad), counts over the nominal scale (mm), forces (N)."""

    radius_mm: float
    opening: tuple[FloatArray, ...]
    said_mm: tuple[FloatArray, ...]
    force_n: tuple[FloatArray, ...]


class _Unknown:
    """Places in the fit's vector; of pad i: base + i."""

    ZERO, SCALE, STANDOFF, SAGITTA, FORCE = 0, 2, 4, 6, 8  # mm, share, mm, mm, mm/N
    OPENING, RADIUS = 10, 11  # rad, mm of each cylinder
    COUNT = 13


def pad_standoffs(
    sessions: Sequence[Iterable[Event]],
    configs: Sequence[PadConfig],
    radii_m: tuple[float, float],
    opening_sd_rad: float,
) -> tuple[PadStandoff, ...]:
    """Both pads, from the events with either cylinder; `configs` are those that the daemon ran with.

    Raises CylinderError for readings that do not suffice.
    """
    heard = [list(events) for events in sessions]
    first = pad_scales(heard[0], tuple(configs), radii_m[0])
    pad_scales(heard[1], tuple(configs), radii_m[1])  # which says what is wrong with it
    taken = [
        _session(readings(events, configs), configs, first, radius)
        for events, radius in zip(heard, radii_m, strict=True)
    ]
    prior_sd = _prior_sd(configs, opening_sd_rad)
    kept = [np.ones(len(each), dtype=np.bool_) for each in _said(taken)]
    noise_mm = [pad.noise_mm for pad in first] * len(taken)
    x, covariance = np.zeros(_Unknown.COUNT), np.zeros((_Unknown.COUNT,) * 2)
    for _ in range(2):
        x, covariance = _solved(x, taken, configs, kept, noise_mm, prior_sd)
        left = _left(x, taken, configs)
        kept = [not_spoilt(each, least=1e-2) for each in left]
        noise_mm = [max(float(np.std(each[some])), 1e-3) for each, some in zip(left, kept, strict=True)]
    return tuple(_told(i, x, np.sqrt(np.diag(covariance)), first[i], left, kept) for i in range(len(PALMS)))


def _session(
    found: Sequence[CylinderReadings], configs: Sequence[PadConfig], nominal: Sequence[PadScale], radius_m: float
) -> _Session:
    opening, said, force = [], [], []
    for own, config, pad in zip(found, configs, nominal, strict=True):
        slow = slow_enough(own)
        pressure = own.pressure[slow]
        at_most = np.nanmax(pressure, initial=0.0)  # of what is at full scale nothing more is known
        opening.append(own.opening[slow])
        said.append(pad.sign * own.counts[slow] / pad.counts_per_mm + pad.zero_mm)
        force.append(np.where(np.isfinite(pressure), pressure, at_most) * config.newtons_per_count)
    return _Session(radius_m * 1e3, tuple(opening), tuple(said), tuple(force))


def _prior_sd(configs: Sequence[PadConfig], opening_sd_rad: float) -> FloatArray:
    """Of the fit's unknowns; zeros, scales and standoffs are what is asked for."""
    sd = np.full(_Unknown.COUNT, np.inf)
    sd[_Unknown.SAGITTA : _Unknown.FORCE] = [pad.sagitta_sd_mm for pad in configs]
    sd[_Unknown.FORCE : _Unknown.OPENING] = [pad.force_sd_mm_per_n for pad in configs]
    sd[_Unknown.OPENING] = opening_sd_rad
    sd[_Unknown.RADIUS :] = RADIUS_SD_MM
    return np.asarray(np.maximum(sd, 1e-9))


def _said(taken: Sequence[_Session]) -> list[FloatArray]:
    return [said for session in taken for said in session.said_mm]


def _model(x: FloatArray, taken: Sequence[_Session], configs: Sequence[PadConfig]) -> list[FloatArray]:
    """What each pad says (mm) of either cylinder, in the order of `_said`."""
    found = []
    for number, session in enumerate(taken):
        radius = session.radius_mm + x[_Unknown.RADIUS + number]
        for i, (opening, force) in enumerate(zip(session.opening, session.force_n, strict=True)):
            s = _foot_mm(x, i, radius, opening + x[_Unknown.OPENING], configs)
            found.append((1.0 + x[_Unknown.SCALE + i]) * s + x[_Unknown.ZERO + i] + x[_Unknown.FORCE + i] * force)
    return found


def _foot_mm(x: FloatArray, i: int, radius_mm: float, opening: FloatArray, configs: Sequence[PadConfig]) -> FloatArray:
    """Where the disc touches palm i + 1: a bowed pad is its tangent there, turned and raised at the hinge."""
    other = 1 - i
    s = radius_mm / np.tan(opening / 2)
    for _ in range(_BOWS):
        turned, raised = np.zeros_like(opening), []
        for pad in (i, other):
            sagitta, length = x[_Unknown.SAGITTA + pad], configs[pad].length_mm
            turned = turned + 4.0 * sagitta / length * (1.0 - 2.0 * s / length)
            raised.append(radius_mm + x[_Unknown.STANDOFF + pad] + 4.0 * sagitta * (s / length) ** 2)
        between = opening - turned
        s = (raised[0] * np.cos(between) + raised[1]) / np.sin(between)
    return np.asarray(s)


def _left(x: FloatArray, taken: Sequence[_Session], configs: Sequence[PadConfig]) -> list[FloatArray]:
    return [said - of for said, of in zip(_said(taken), _model(x, taken, configs), strict=True)]


def _solved(
    x: FloatArray,
    taken: Sequence[_Session],
    configs: Sequence[PadConfig],
    kept: Sequence[Bools],
    noise_mm: Sequence[float],
    prior_sd: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """The unknowns and their covariance."""

    def weighed(each: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([part[some] / sd for part, some, sd in zip(each, kept, noise_mm, strict=True)])

    for _ in range(_ROUNDS):
        columns = []
        for unit in _STEP * np.eye(len(x)):
            sides = (_model(x + sign * unit, taken, configs) for sign in (1.0, -1.0))
            columns.append(weighed([(a - b) / (2 * _STEP) for a, b in zip(*sides, strict=True)]))
        rows = np.stack(columns, axis=1)
        information = rows.T @ rows + np.diag(prior_sd**-2)
        step = np.linalg.solve(information, rows.T @ weighed(_left(x, taken, configs)) - x * prior_sd**-2)
        x = x + step
        if np.abs(step).max() < _SETTLED_MM:
            return x, np.asarray(np.linalg.inv(information), dtype=np.float64)
    raise CylinderError("no standoff explains the readings: are the radii right, in the order in which they lay there?")


def _told(
    i: int, x: FloatArray, sd: FloatArray, nominal: PadScale, left: Sequence[FloatArray], kept: Sequence[Bools]
) -> PadStandoff:
    own = [(each, some) for number, (each, some) in enumerate(zip(left, kept, strict=True)) if number % 2 == i]
    scale = 1.0 + float(x[_Unknown.SCALE + i])
    # said = (1 + scale)·s + zero in nominal millimetres: so s = (nominal zero − zero)/(1 + scale) + counts/…
    return PadStandoff(
        sign=nominal.sign,
        zero_mm=(nominal.zero_mm - float(x[_Unknown.ZERO + i])) / scale,
        zero_sd_mm=float(sd[_Unknown.ZERO + i]),
        counts_per_mm=nominal.counts_per_mm * scale,
        scale_sd=float(sd[_Unknown.SCALE + i]),
        standoff_mm=float(x[_Unknown.STANDOFF + i]),
        standoff_sd_mm=float(sd[_Unknown.STANDOFF + i]),
        noise_mm=math.sqrt(float(np.mean(np.concatenate([each[some] for each, some in own]) ** 2))),
        readings=sum(int(some.sum()) for _, some in own),
        spoilt=sum(int((~some).sum()) for _, some in own),
    )
