"""Both pads' newtons per count from the weight of a machined cylinder between the palms. Pure.

The palms rest in a sequence of poses; the mean pressure of each rest is one measurement. Friction at rest is unknown
and does not average out: a cylinder that slid down is supported by friction, one that was pushed up is held down, by
unequal amounts. But the difference of both forces does not depend on friction (`palmd.calibration.cylinder`), so that

    k1·c1 − k2·c2 = m·g·cos β/cos(φ2/2)

holds in every pose for the pressures c1, c2 (counts) and the unknown k1, k2 (N per count). Tipping the V to both sides
determines both: upright the difference vanishes, which gives k1/k2, and tipped it gives their size.

Least squares would be biased low, because the noise is in c1 and c2. The pose is exact and correlated with them, so its
frictionless forces N1, N2 serve as instrumental variables: Zᵀ(M·k − y) = 0 with the rows Z = (N1, −N2), M = (c1, −c2).
Each round of poses is also solved separately: a resistive pad's gain creeps within a minute, and the scatter between
rounds shows by how much.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.calibration.cylinder import CylinderError, CylinderReadings, equivalent_flat_angles, normal_forces, readings
from palmd.config.pads import PadConfig
from palmd.events import Event, FloatArray
from palmd.system.arcs import FLAT

MIN_ROUNDS = 2

_STILL_RAD_S = 1e-4
_SETTLING_S = 0.3  # left out at the beginning of each rest
_MIN_REST_S = 0.3
_MIN_READINGS = 10
_DRIFT_FACTOR = 1.25
"""Factor on 1σ of a mean of rounds, as neighbouring rounds of a minute are correlated by a drift of 20 s."""
_MIN_DIFFERENCE_SHARE = 0.2  # of the weight, by which the difference of the forces must vary


@dataclass(frozen=True, slots=True)
class PadForce:
    """One pad: newtons_per_count with 1σ, and the result of a line with an offset.

    share_left: RMS residual of the force at rest, relative to the force: drift, hysteresis and friction.
    offset_n: the force at which the pressure would be zero, if friction averages out.
    least_n, greatest_n: range of the forces.
    """

    newtons_per_count: float
    newtons_per_count_sd: float
    share_left: float
    offset_n: float
    offset_sd_n: float
    least_n: float
    greatest_n: float
    saturated: int


@dataclass(frozen=True, slots=True)
class Forces:
    """Both pads; `friction`: largest share of a normal force that friction carries at rest (mean over poses)."""

    pads: tuple[PadForce, ...]
    friction: float
    rests: int
    rounds: int


@dataclass(frozen=True, slots=True)
class _Rests:
    """n rests: mean pressures of each pad (2, n) in counts, the first palm's angle and the opening (n) in rad.

    For curved palms the angles are replaced by those of their tangents.
    """

    counts: FloatArray
    first: FloatArray
    opening: FloatArray

    def __len__(self) -> int:
        return len(self.first)

    def __getitem__(self, some: slice) -> _Rests:
        return _Rests(self.counts[:, some], self.first[some], self.opening[some])


def pad_forces(
    events: Iterable[Event],
    configs: tuple[PadConfig, ...],
    weight_n: float,
    poses: int,
    *,
    radius_m: float,
    curvatures: Sequence[float] = FLAT,
) -> Forces:
    """Both pads from at least MIN_ROUNDS rounds of this many poses; `configs` are those the daemon ran with.

    The cylinder's radius determines the tangents of palms of these curvatures (1/m). Raises CylinderError if the
    readings do not suffice.
    """
    pads = readings(events, configs)
    rests = _rests(*pads)
    first, opening = equivalent_flat_angles(radius_m, rests.first, rests.opening, curvatures)
    rests = replace(rests, first=first, opening=opening)
    rounds = round(len(rests) / poses)
    if rounds < MIN_ROUNDS or len(rests) < MIN_ROUNDS * poses - poses // 4:
        raise CylinderError(
            f"the cylinder rested on both pads {len(rests)} times, at least {MIN_ROUNDS * poses} are needed: it must"
            " lie on both palms all the time, and press less than the pads' full scale"
        )
    wanted = _difference(rests, weight_n)
    if np.ptp(wanted) < _MIN_DIFFERENCE_SHARE * weight_n:
        raise CylinderError("the palms hardly tipped the cylinder: was the plan stopped?")
    gains = _gains(rests, weight_n)
    each = np.array([_gains(part, weight_n) for part in _parts(rests, rounds)])
    sds = _DRIFT_FACTOR * each.std(axis=0, ddof=1) / math.sqrt(rounds)
    if gains.min() <= 0.0:
        raise CylinderError(
            "the pressures do not follow the weight as the V is tipped: check for swapped pads and for other objects"
        )
    friction = _friction(rests, weight_n, gains)
    each_pad = tuple(
        _pad_result(number, rests, rounds, weight_n, float(gain), float(sd), found)
        for number, (gain, sd, found) in enumerate(zip(gains, sds, pads, strict=True))
    )
    return Forces(each_pad, friction, len(rests), rounds)


def _parts(rests: _Rests, rounds: int) -> list[_Rests]:
    edges = np.linspace(0, len(rests), rounds + 1).round().astype(int).tolist()
    return [rests[slice(low, high)] for low, high in itertools.pairwise(edges)]


def _difference(rests: _Rests, weight_n: float) -> FloatArray:
    """N1 − N2 (N)."""
    return np.asarray(weight_n * np.cos(rests.first + rests.opening / 2.0) / np.cos(rests.opening / 2.0))


def _gains(rests: _Rests, weight_n: float) -> FloatArray:
    signs = np.array([[1.0], [-1.0]])
    instruments = signs * np.stack(normal_forces(weight_n, rests.first, rests.opening))
    regressors = signs * rests.counts
    gains = np.linalg.solve(instruments @ regressors.T, instruments @ _difference(rests, weight_n))
    return np.asarray(gains, dtype=np.float64)


def _friction(rests: _Rests, weight_n: float, gains: FloatArray) -> float:
    """RMS of T over the normal force: N1 + N2 = m·g·sin β/sin(φ2/2) − 2T/tan(φ2/2)."""
    total = gains[0] * rests.counts[0] + gains[1] * rests.counts[1]
    half_opening = rests.opening / 2.0
    friction = (weight_n * np.sin(rests.first + half_opening) / np.sin(half_opening) - total) * np.tan(half_opening)
    return float(np.sqrt(np.mean((friction / total) ** 2)))


def _pad_result(
    number: int, rests: _Rests, rounds: int, weight_n: float, gain: float, gain_sd: float, found: CylinderReadings
) -> PadForce:
    force, counts = normal_forces(weight_n, rests.first, rests.opening)[number], rests.counts[number]
    offsets = [_offset(part, number, weight_n) for part in _parts(rests, rounds)]
    return PadForce(
        newtons_per_count=gain,
        newtons_per_count_sd=gain_sd,
        share_left=float(np.sqrt(np.mean((gain * counts / force - 1.0) ** 2))),
        offset_n=float(np.mean(offsets)),
        offset_sd_n=float(np.std(offsets, ddof=1)) / math.sqrt(rounds),
        least_n=float(force.min()),
        greatest_n=float(force.max()),
        saturated=int(np.sum(np.isnan(found.pressure))),
    )


def _offset(rests: _Rests, number: int, weight_n: float) -> float:
    """The force (N) at which the line of pressure over frictionless force crosses zero pressure."""
    force = normal_forces(weight_n, rests.first, rests.opening)[number]
    slope, level = np.polyfit(force, rests.counts[number], 1)
    return float(-level / slope)


def _rests(*pads: CylinderReadings) -> _Rests:
    """The rests in time order, without those in which a pad was silent or at full scale."""
    rows = []
    for begin, end in _rest_intervals(pads[0]):
        means = [
            (
                float(pad.pressure[selected].mean()),
                float(pad.first[selected].mean()),
                float(pad.opening[selected].mean()),
            )
            for pad in pads
            if np.sum(selected := (pad.t >= begin) & (pad.t <= end)) >= _MIN_READINGS
        ]
        if len(means) == len(pads) and all(math.isfinite(pressure) for pressure, _, _ in means):
            rows.append((*(pressure for pressure, _, _ in means), *means[0][1:]))
    table = np.array(rows, dtype=np.float64).reshape(-1, len(pads) + 2).T
    return _Rests(table[: len(pads)], *table[len(pads) :])


def _rest_intervals(found: CylinderReadings) -> list[tuple[float, float]]:
    """Beginning and end of each rest (s), without the time to settle."""
    is_at_rest = (found.rate <= _STILL_RAD_S).astype(np.int8)
    edges = np.flatnonzero(np.diff(is_at_rest, prepend=0, append=0)).reshape(-1, 2).tolist()
    intervals = [(float(found.t[low]) + _SETTLING_S, float(found.t[high - 1])) for low, high in edges]
    return [(begin, end) for begin, end in intervals if end - begin >= _MIN_REST_S]
