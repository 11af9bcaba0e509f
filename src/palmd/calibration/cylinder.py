"""A turned cylinder between the palms as a gauge: where it touches, how it presses, how to move it. Pure.

A disc of radius R that touches both palms does so at s1 = s2 = R/tan(φ2/2), whatever friction and gravity: (3.13) and
(3.14) of the paper with r1 = r2 = R and d1 = d2 = 0. At rest its weight m·g asks for the normal forces (N)

    N1 = m·g·sin φ12/sin φ2 − T/tan(φ2/2),    N2 = m·g·sin φ1/sin φ2 − T/tan(φ2/2),

where T is the friction that holds it up on either palm. Nothing tells T, but it is the same on both, for the disc's
own moment (T1 + T2)·R must vanish. So the difference of the two forces knows nothing of friction:

    N1 − N2 = m·g·cos β/cos(φ2/2),    β = φ1 + φ2/2 the direction of the V's middle line.

Palms that are arcs press as flat ones that lie as their tangents at the contacts (`lying`).
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
LEAST_TRAVEL_M = 0.010
SLOW_RAD_S = math.radians(10.0)
BRISK_RAD_S = math.radians(40.0)
FRESH_S = 0.05
"""A reading counts while the other pad and the arm have spoken within so much of it."""

_SHARE = 0.5  # of the configured rate and acceleration that the plans use at most
_ROOM = math.radians(1.0)  # that the poses keep from the limits
_TIP = math.radians(20.0)
_TIPS = 4
_LEAST_SHARE = 0.15  # of the weight that either palm must bear
_OPENINGS = (math.radians(70.0), math.radians(90.0), math.radians(110.0))
_HOLD_S = 1.0
_FINE = 256  # openings among which those of the tangents are sought
_SHORTEST_S = 0.6
_SPOILT = 6.0  # scaled median deviations
_WHOLE = 0.02  # what undoing the configuration may leave beyond whole counts


class CylinderError(ValueError):
    """The poses or the readings do not allow the calibration; the text says why and what to do."""


@dataclass(frozen=True, slots=True)
class CylinderReadings:
    """One pad's readings while both pads were touched: t (s), counts, pressure (counts, NaN at full scale).

    The counts are what a pad that needs no configured curve would have given, `raw` what this one gave. Beside them the
    palms' angles at these times (rad) and the larger of their planned rates (rad/s).
    """

    t: FloatArray
    counts: FloatArray
    raw: FloatArray
    pressure: FloatArray
    first: FloatArray
    opening: FloatArray
    rate: FloatArray


def contact_m(radius_m: float, phi2: FloatArray) -> FloatArray:
    """Where a disc touches either palm (m from the hinge), phi2 in rad: (3.13) with r1 = r2, d1 = 0."""
    return np.asarray(radius_m / np.tan(phi2 / 2.0))


def contacts_m(radius_m: float, phi2: FloatArray, curvatures: Sequence[float] = FLAT) -> FloatArray:
    """Where a disc touches palm 1 and palm 2 (2, n) (m from the hinge); on arcs of these curvatures (1/m) as well."""
    if not any(curvatures):
        return np.stack([contact_m(radius_m, phi2)] * len(PALMS))
    still = np.zeros(len(phi2))
    return contacts_on_arcs(np.array([radius_m]), still, phi2, still, curvatures)


def lying(radius_m: float, phi1: FloatArray, phi2: FloatArray, curvatures: Sequence[float]) -> tuple[FloatArray, ...]:
    """φ1, φ2 (rad) of flat palms that lie as arcs of these curvatures (1/m) do where a disc touches them."""
    return tangents((phi1, phi2), contacts_m(radius_m, phi2, curvatures), curvatures)


def normal_forces(weight_n: float, phi1: FloatArray, phi2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The forces on palm 1 and palm 2 (N) at rest without friction; angles in rad."""
    share = weight_n / np.sin(phi2)
    return np.asarray(share * np.sin(phi1 + phi2)), np.asarray(share * np.sin(phi1))


def readings(events: Iterable[Event], configs: Sequence[PadConfig]) -> tuple[CylinderReadings, CylinderReadings]:
    """Both pads' readings in counts again; `configs` are those with which the daemon made millimetres of them.

    Raises CylinderError for readings that were not made with them.
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


def not_spoilt(left: FloatArray, least: float) -> npt.NDArray[np.bool_]:
    """Which of the residuals lie within six scaled median deviations, `least` at least, of their median."""
    away = np.abs(left - float(np.median(left)))
    return np.asarray(away <= _SPOILT * max(1.4826 * float(np.median(away)), least))


def turning_plan(radius_m: float, limits: MotionLimits) -> dict[str, Any]:
    """A motion plan that takes the contacts slowly over the pads, both ways, and tips the V to both sides.

    The way of the contacts is as long as pads and limits allow; CylinderError when that is not enough.
    """
    low, high = opening_range(radius_m, limits)
    ends = contacts_m(radius_m, np.array([low, high]), limits.curvatures)
    travel = float((ends[:, 0] - ends[:, 1]).min()) if low < high else 0.0
    if travel < LEAST_TRAVEL_M:
        raise CylinderError(_too_little(radius_m, limits, travel))
    middle = opening_at(radius_m, float(ends.mean()), limits.curvatures)
    poses = [_upright(phi2, limits) for phi2 in (middle, high, low, middle)]
    phi1, phi2 = poses[-1]
    poses += [(_within(phi1 + tip, phi2, limits), phi2) for tip in (_TIP, -_TIP, 0.0)]
    return _plan("calibrate pads", poses, limits, SLOW_RAD_S)


def tipping_plan(radius_m: float, limits: MotionLimits, rounds: int) -> tuple[dict[str, Any], int]:
    """A motion plan that stands in poses of different openings, tipped to both sides, and their number in a round.

    Every pose is come to from both sides, and both palms bear a fair share of the weight in each. CylinderError
    when the limits leave no room for that.
    """
    low, high = opening_range(radius_m, limits)
    if low >= high:
        raise CylinderError(_too_little(radius_m, limits, 0.0))
    openings = np.linspace(low, high, _FINE)
    _, opened = lying(radius_m, np.zeros(_FINE), openings, limits.curvatures)
    narrow, middle, wide = np.interp(_OPENINGS, opened, openings).tolist()
    poses: list[Angles] = []
    rests = set[int]()
    for phi2 in (narrow, middle, wide, middle):
        least, most = _tipped(radius_m, phi2, limits)
        room = max(most - least, 0.0)
        if room < _TIP:
            raise CylinderError(
                f"at phi2 = {math.degrees(phi2):.0f}° the limits let phi1 turn by {math.degrees(room):.0f}° only, which"
                f" moves too little weight; {math.degrees(_TIP):.0f}° is the least: widen limits.phi1_deg"
            )
        end, *tips, other_end = np.linspace(least, most, _TIPS + 2).tolist()
        for turn, between in ((end, tips), (other_end, tips[::-1])):
            poses.append((turn, phi2))
            rests |= set(range(len(poses), len(poses) + len(between)))
            poses += [(phi1, phi2) for phi1 in between]
    return _plan("calibrate force", poses, limits, BRISK_RAD_S, rests=rests, repeat=rounds), len(rests)


def opening_range(radius_m: float, limits: MotionLimits) -> tuple[float, float]:
    """The least and greatest phi2 (rad) with both contacts well on the pads; the first is larger if there is none."""
    least, most = (opening_at(radius_m, s, limits.curvatures) for s in (limits.pad_length - PAD_MARGIN_M, PAD_MARGIN_M))
    steepest = PHI12_MAX - limits.angles[0][0] - 3.0 * _ROOM
    return max(least, limits.angles[1][0] + _ROOM), min(most, limits.angles[1][1] - _ROOM, steepest)


def _upright(phi2: float, limits: MotionLimits) -> Angles:
    return _within((math.pi - phi2) / 2.0, phi2, limits), phi2


def _within(phi1: float, phi2: float, limits: MotionLimits) -> float:
    """The phi1 next to it that the limits allow."""
    most = min(limits.angles[0][1], PHI12_MAX - phi2 - _ROOM) - _ROOM
    return max(min(phi1, most), limits.angles[0][0] + _ROOM)


def _tipped(radius_m: float, phi2: float, limits: MotionLimits) -> tuple[float, float]:
    """The range of phi1 in which either palm bears its least share of the weight.

    It ends where a force is largest (φ12 or φ1 upright): beyond, that force would be come to from below both ways.
    """
    turned, opened = (float(angle[0]) for angle in lying(radius_m, np.zeros(1), np.array([phi2]), limits.curvatures))
    edge = math.asin(_LEAST_SHARE * math.sin(opened))
    least, most = max(edge, math.pi / 2.0 - opened), min(math.pi - opened - edge, math.pi / 2.0)
    return _within(least - turned, phi2, limits), _within(most - turned, phi2, limits)


def _too_little(radius_m: float, limits: MotionLimits, travel_m: float) -> str:
    told = (
        f"a cylinder of {radius_m * 1e3:g} mm radius can be moved by {travel_m * 1e3:.1f} mm along the pads;"
        f" {LEAST_TRAVEL_M * 1e3:g} mm is the least"
    )
    if max(limits.curvatures) * radius_m >= MOST_LYING:
        return f"{told}: it would lie in the palms rather than on them, the radius is too large"
    if (
        float(contacts_m(radius_m, np.array([limits.angles[1][1]]), limits.curvatures).min())
        > limits.pad_length - PAD_MARGIN_M - LEAST_TRAVEL_M
    ):
        return f"{told}: the radius is too large for these pads and limits.phi2_deg"
    return f"{told}: take a larger cylinder, or widen limits.phi1_deg and limits.phi2_deg"


def _plan(
    name: str, poses: Sequence[Angles], limits: MotionLimits, rate: float, rests: Collection[int] = (), repeat: int = 1
) -> dict[str, Any]:
    """Moves from one pose to the next, with a rest in those poses whose numbers are given."""
    segments: list[dict[str, Any]] = []
    rate = min(rate, _SHARE * limits.rate)
    for number, pose in enumerate(poses):
        before = poses[number - 1]
        way = max(abs(pose[0] - before[0]), abs(pose[1] - before[1]))
        seconds = max(
            PEAK_RATE * way / rate, math.sqrt(PEAK_ACCELERATION * way / (_SHARE * limits.acceleration)), _SHORTEST_S
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
    fresh = (_nearest(own[:, 0], other) <= FRESH_S) & (_nearest(own[:, 0], palms[:, 0]) <= FRESH_S)
    t, s, force = own[fresh].T
    counts, straight = (
        config.sign * (each - config.zero_mm) * config.counts_per_mm for each in (linear_mm(config, s * 1e3), s * 1e3)
    )
    pressure = force / config.newtons_per_count
    if len(t) and max(_off_whole(counts), _off_whole(pressure[np.isfinite(pressure)])) > _WHOLE:
        raise CylinderError(
            f"the daemon did not make pad {number}'s readings with this configuration: start it anew with it"
        )
    if not len(t):
        return CylinderReadings(t, straight, counts, pressure, t, t, t)
    phi1, phi2, rate = (np.interp(t, palms[:, 0], palms[:, column]) for column in (1, 2, 3))
    return CylinderReadings(t, straight, np.rint(counts), np.rint(pressure), phi1, phi2, rate)


def _off_whole(values: FloatArray) -> float:
    """How far from whole numbers they are, all in all."""
    return float(np.mean(np.abs(values - np.rint(values)))) if len(values) else 0.0


def _nearest(t: FloatArray, times: FloatArray) -> FloatArray:
    """The time from each t to the nearest of the others, which are in order (s)."""
    if not len(times):
        return np.full(len(t), np.inf)
    after = np.clip(np.searchsorted(times, t), 1, max(len(times) - 1, 1))
    return np.minimum(np.abs(times[np.minimum(after, len(times) - 1)] - t), np.abs(t - times[after - 1]))
