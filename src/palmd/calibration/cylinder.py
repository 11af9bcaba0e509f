"""A machined cylinder between the palms as a gauge: contact positions, normal forces, and plans to move it. Pure.

A disc of radius R that touches both palms does so at s1 = s2 = R/tan(φ2/2), independent of friction and gravity: (3.13)
and (3.14) of the paper with r1 = r2 = R and d1 = d2 = 0. At rest its weight m·g requires the normal forces (N)

    N1 = m·g·sin φ12/sin φ2 − T/tan(φ2/2),    N2 = m·g·sin φ1/sin φ2 − T/tan(φ2/2),

where T is the friction that supports it on each palm. T is unknown but the same on both palms, because the disc's
moment (T1 + T2)·R must vanish. So the difference of the two forces does not depend on friction:

    N1 − N2 = m·g·cos β/cos(φ2/2),    β = φ1 + φ2/2 the direction of the V's middle line.

Curved palms have the same forces as flat ones along their tangents at the contacts (`equivalent_flat_angles`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.config.pads import PadConfig
from palmd.devices.pad import linear_mm
from palmd.events import Event, FloatArray, PadSample, PalmSample
from palmd.model.arcs import contacts_on_arcs
from palmd.motion.limits import PHI12_MAX, MotionLimits
from palmd.motion.segments import PEAK_ACCELERATION, PEAK_RATE, Angles
from palmd.system.arcs import FLAT, MOST_LYING, opening_at, tangents
from palmd.system.mechanism import PALMS

PAD_MARGIN_M = 5e-3  # so much of a pad's end is left alone: its zero may be that far off
MIN_TRAVEL_M = 0.010
SLOW_RAD_S = math.radians(10.0)
BRISK_RAD_S = math.radians(40.0)
MAX_AGE_S = 0.05
"""A reading is used if the other pad and the arm have reported within this time."""

_LIMIT_SHARE = 0.5  # of the configured rate and acceleration that the plans use at most
_LIMIT_MARGIN = math.radians(1.0)  # that the poses keep from the limits
_MIN_TIP = math.radians(20.0)
_TIPS = 4
_MIN_WEIGHT_SHARE = 0.15  # of the weight that either palm must bear
_OPENINGS = (math.radians(70.0), math.radians(90.0), math.radians(110.0))
_HOLD_S = 1.0
_FINE = 256  # openings among which those of the tangents are sought
_MIN_MOVE_S = 0.6
_OUTLIER_LIMIT = 6.0  # scaled median deviations
_MAX_ROUNDING_ERROR = 0.02  # what undoing the configuration may leave beyond whole counts


class CylinderError(ValueError):
    """The poses or the readings do not allow the calibration; the text states the reason and the remedy."""


@dataclass(frozen=True, slots=True)
class CylinderReadings:
    """One pad's readings while both pads were touched: t (s), counts, pressure (counts, NaN at full scale).

    `counts` are corrected for the configured curve, `raw` are as read. Also the palms' angles at these times (rad) and
    the larger of their planned rates (rad/s).
    """

    t: FloatArray
    counts: FloatArray
    raw: FloatArray
    pressure: FloatArray
    first: FloatArray
    opening: FloatArray
    rate: FloatArray


def contact_m(radius_m: float, phi2: FloatArray) -> FloatArray:
    """Contact of a disc with either palm (m from the hinge), phi2 in rad: (3.13) with r1 = r2, d1 = 0."""
    return np.asarray(radius_m / np.tan(phi2 / 2.0))


def contacts_m(radius_m: float, phi2: FloatArray, curvatures: Sequence[float] = FLAT) -> FloatArray:
    """Contacts of a disc with palm 1 and palm 2 (2, n) (m from the hinge), for palms of these curvatures (1/m)."""
    if not any(curvatures):
        return np.stack([contact_m(radius_m, phi2)] * len(PALMS))
    still = np.zeros(len(phi2))
    return contacts_on_arcs(np.array([radius_m]), still, phi2, still, curvatures)


def equivalent_flat_angles(
    radius_m: float, phi1: FloatArray, phi2: FloatArray, curvatures: Sequence[float]
) -> tuple[FloatArray, ...]:
    """φ1, φ2 (rad) of flat palms along the tangents of curved ones (1/m) at the contacts of a disc."""
    return tangents((phi1, phi2), contacts_m(radius_m, phi2, curvatures), curvatures)


def normal_forces(weight_n: float, phi1: FloatArray, phi2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Forces on palm 1 and palm 2 (N) at rest without friction; angles in rad."""
    share = weight_n / np.sin(phi2)
    return np.asarray(share * np.sin(phi1 + phi2)), np.asarray(share * np.sin(phi1))


def readings(events: Iterable[Event], configs: Sequence[PadConfig]) -> tuple[CylinderReadings, CylinderReadings]:
    """Both pads' readings in counts; `configs` are those with which the daemon converted them to millimetres.

    Raises CylinderError for readings that were made with others.
    """
    events = list(events)
    palms = np.array(
        [
            (event.t_sample, *event.angles, max(map(abs, event.rates)))
            for event in events
            if isinstance(event, PalmSample) and event.rates is not None
        ]
    ).reshape(-1, 4)
    first, second = (_samples(events, number) for number in PALMS)
    return (
        _readings(1, first, second[:, 0], palms, configs[0]),
        _readings(2, second, first[:, 0], palms, configs[1]),
    )


def inliers(residuals: FloatArray, min_scale: float) -> npt.NDArray[np.bool_]:
    """Which residuals are within six scaled median absolute deviations (at least `min_scale` each) of the median."""
    deviations = np.abs(residuals - float(np.median(residuals)))
    return np.asarray(deviations <= _OUTLIER_LIMIT * max(1.4826 * float(np.median(deviations)), min_scale))


def turning_plan(radius_m: float, limits: MotionLimits) -> dict[str, Any]:
    """A motion plan that moves the contacts slowly over the pads, both ways, and tips the V to both sides.

    The contacts travel as far as pads and limits allow; raises CylinderError if that is not enough.
    """
    low, high = opening_range(radius_m, limits)
    ends = contacts_m(radius_m, np.array([low, high]), limits.curvatures)
    travel = float((ends[:, 0] - ends[:, 1]).min()) if low < high else 0.0
    if travel < MIN_TRAVEL_M:
        raise CylinderError(_insufficient_travel(radius_m, limits, travel))
    middle = opening_at(radius_m, float(ends.mean()), limits.curvatures)
    poses = [(_within((math.pi - phi2) / 2.0, phi2, limits), phi2) for phi2 in (middle, high, low, middle)]
    phi1, phi2 = poses[-1]
    poses += [(_within(phi1 + tip, phi2, limits), phi2) for tip in (_MIN_TIP, -_MIN_TIP, 0.0)]
    return _plan("calibrate pads", poses, limits, SLOW_RAD_S)


def tipping_plan(radius_m: float, limits: MotionLimits, rounds: int) -> tuple[dict[str, Any], int]:
    """A motion plan with rests at several openings, tipped to both sides, and the number of rests per round.

    Every pose is approached from both sides, and both palms carry a fair share of the weight in each. Raises
    CylinderError if the limits leave no room for that.
    """
    low, high = opening_range(radius_m, limits)
    if low >= high:
        raise CylinderError(_insufficient_travel(radius_m, limits, 0.0))
    openings = np.linspace(low, high, _FINE)
    _, opened = equivalent_flat_angles(radius_m, np.zeros(_FINE), openings, limits.curvatures)
    narrow, middle, wide = np.interp(_OPENINGS, opened, openings).tolist()
    poses: list[Angles] = []
    rest_numbers = set[int]()
    for phi2 in (narrow, middle, wide, middle):
        lowest, highest = _tipped(radius_m, phi2, limits)
        tip_range = max(highest - lowest, 0.0)
        if tip_range < _MIN_TIP:
            raise CylinderError(
                f"at phi2 = {math.degrees(phi2):.0f}° the limits allow phi1 a range of {math.degrees(tip_range):.0f}°"
                f" only; the weight shifts enough from {math.degrees(_MIN_TIP):.0f}° on: widen limits.phi1_deg"
            )
        end, *tips, other_end = np.linspace(lowest, highest, _TIPS + 2).tolist()
        for end_phi1, inner in ((end, tips), (other_end, tips[::-1])):
            poses.append((end_phi1, phi2))
            rest_numbers |= set(range(len(poses), len(poses) + len(inner)))
            poses += [(phi1, phi2) for phi1 in inner]
    return _plan("calibrate force", poses, limits, BRISK_RAD_S, rests=rest_numbers, repeat=rounds), len(rest_numbers)


def opening_range(radius_m: float, limits: MotionLimits) -> tuple[float, float]:
    """The smallest and largest phi2 (rad) with both contacts well on the pads; the first is larger if there is none."""
    lowest, highest = (
        opening_at(radius_m, s, limits.curvatures) for s in (limits.pad_length - PAD_MARGIN_M, PAD_MARGIN_M)
    )
    steepest = PHI12_MAX - limits.angles[0][0] - 3.0 * _LIMIT_MARGIN
    return max(lowest, limits.angles[1][0] + _LIMIT_MARGIN), min(highest, limits.angles[1][1] - _LIMIT_MARGIN, steepest)


def _within(phi1: float, phi2: float, limits: MotionLimits) -> float:
    """The nearest phi1 that the limits allow."""
    highest = min(limits.angles[0][1], PHI12_MAX - phi2 - _LIMIT_MARGIN) - _LIMIT_MARGIN
    return max(min(phi1, highest), limits.angles[0][0] + _LIMIT_MARGIN)


def _tipped(radius_m: float, phi2: float, limits: MotionLimits) -> tuple[float, float]:
    """The range of phi1 in which each palm carries its minimum share of the weight.

    It ends where a force is at its maximum (φ12 or φ1 upright), as beyond that the force would be approached from below
    on both ways.
    """
    flat_phi1, flat_phi2 = (
        float(angle[0]) for angle in equivalent_flat_angles(radius_m, np.zeros(1), np.array([phi2]), limits.curvatures)
    )
    edge = math.asin(_MIN_WEIGHT_SHARE * math.sin(flat_phi2))
    lowest, highest = max(edge, math.pi / 2.0 - flat_phi2), min(math.pi - flat_phi2 - edge, math.pi / 2.0)
    return _within(lowest - flat_phi1, phi2, limits), _within(highest - flat_phi1, phi2, limits)


def _insufficient_travel(radius_m: float, limits: MotionLimits, travel_m: float) -> str:
    message = (
        f"a cylinder of {radius_m * 1e3:g} mm radius can be moved by {travel_m * 1e3:.1f} mm along the pads;"
        f" at least {MIN_TRAVEL_M * 1e3:g} mm are needed"
    )
    if max(limits.curvatures) * radius_m >= MOST_LYING:
        return f"{message}: it would nest in the concave palms, choose a smaller radius"
    if (
        float(contacts_m(radius_m, np.array([limits.angles[1][1]]), limits.curvatures).min())
        > limits.pad_length - PAD_MARGIN_M - MIN_TRAVEL_M
    ):
        return f"{message}: the radius is too large for these pads and limits.phi2_deg"
    return f"{message}: use a larger cylinder, or widen limits.phi1_deg and limits.phi2_deg"


def _plan(
    name: str, poses: Sequence[Angles], limits: MotionLimits, rate: float, rests: Collection[int] = (), repeat: int = 1
) -> dict[str, Any]:
    """Moves from one pose to the next, with a hold in the poses whose numbers are in `rests`."""
    segments: list[dict[str, Any]] = []
    rate = min(rate, _LIMIT_SHARE * limits.rate)
    for number, pose in enumerate(poses):
        before = poses[number - 1]
        distance = max(abs(pose[0] - before[0]), abs(pose[1] - before[1]))
        seconds = max(
            PEAK_RATE * distance / rate,
            math.sqrt(PEAK_ACCELERATION * distance / (_LIMIT_SHARE * limits.acceleration)),
            _MIN_MOVE_S,
        )
        phi1_deg, phi2_deg = (round(math.degrees(angle), 3) for angle in pose)
        segments.append({"move": {"phi1_deg": phi1_deg, "phi2_deg": phi2_deg}, "duration_s": round(seconds, 2)})
        segments += [{"hold_s": _HOLD_S}] if number in rests else []
    return {"name": name, "repeat": repeat, "segments": segments}


def _samples(events: Iterable[Event], number: int) -> FloatArray:
    rows = [
        (event.t_sample, event.s, math.nan if event.force is None else event.force)
        for event in events
        if isinstance(event, PadSample) and event.pad == number
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _readings(
    number: int, own: FloatArray, other: FloatArray, palms: FloatArray, config: PadConfig
) -> CylinderReadings:
    is_fresh = (_nearest(own[:, 0], other) <= MAX_AGE_S) & (_nearest(own[:, 0], palms[:, 0]) <= MAX_AGE_S)
    t, s, force = own[is_fresh].T
    counts, straight = (
        config.sign * (s_mm - config.zero_mm) * config.counts_per_mm for s_mm in (linear_mm(config, s * 1e3), s * 1e3)
    )
    pressure = force / config.newtons_per_count
    if (
        len(t)
        and max(_mean_rounding_error(counts), _mean_rounding_error(pressure[np.isfinite(pressure)]))
        > _MAX_ROUNDING_ERROR
    ):
        raise CylinderError(
            f"pad {number}'s readings were made with another configuration: restart the daemon with this one"
        )
    if not len(t):
        return CylinderReadings(t, straight, counts, pressure, t, t, t)
    phi1, phi2, rate = (np.interp(t, palms[:, 0], palms[:, column]) for column in (1, 2, 3))
    return CylinderReadings(t, straight, np.rint(counts), np.rint(pressure), phi1, phi2, rate)


def _mean_rounding_error(values: FloatArray) -> float:
    """Mean distance of the values from whole numbers."""
    return float(np.mean(np.abs(values - np.rint(values)))) if len(values) else 0.0


def _nearest(t: FloatArray, times: FloatArray) -> FloatArray:
    """Time from each t to the nearest of the other times, which are sorted (s)."""
    if not len(times):
        return np.full(len(t), np.inf)
    after = np.clip(np.searchsorted(times, t), 1, max(len(times) - 1, 1))
    return np.minimum(np.abs(times[np.minimum(after, len(times) - 1)] - t), np.abs(t - times[after - 1]))
