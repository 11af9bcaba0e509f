"""Error of a gripper's reported pivot position, from a cylinder that it drags over the pad. Pure.

A cylinder of radius R held at a distance b off its axis has h_P = R + b cos(θ − θ0). The measured lever arm e = h_P′
and height z = h_P lie on a circle,

    (e − along)² + (z − height − R)² = b²,

whose centre would be at (0, R) without errors of the position. The result does not depend on force, friction or the
cylinder's rotation. Solved for (height, along, b) and for further parameters with priors from the configuration: the
pad's scale, its slope along the arm's x, its bow, and its lag.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.calibration.cylinder import inliers
from palmd.calibration.solving import solved
from palmd.events import Event, FloatArray, PadSample, PalmSample
from palmd.system.pivot import PivotRig

MAX_GAP_S = 0.05  # between the arm's reports around a reading
MIN_READINGS = 200
MIN_HEIGHT_RANGE_M = 1e-3
MAX_SD_M = 5e-5  # of the height, beyond which there is no result
MAX_RESIDUAL_RATIO = 2.0  # RMS residual over the readings' noise
_TRIMMING_ROUNDS, _MIN_SCALE_M = 5, 1e-4  # rounds without outliers, and the smallest scale of deviations for them
_NEAR_M = 1e-3  # lever arm below which the contact's speed is damped towards zero


class HeightError(ValueError):
    """The readings do not determine the height; the text states the reason and the remedy."""


@dataclass(frozen=True, slots=True)
class PivotHeight:
    """The reported minus the true pivot position, over the pad's middle and along it (mm), with 1σ.

    off_axis_mm: distance of the pivot from the cylinder's axis. slope_deg: rise of the pad along the arm's x. left: RMS
    residual over the readings' noise.
    """

    height_mm: float
    height_sd_mm: float
    along_mm: float
    along_sd_mm: float
    off_axis_mm: float
    slope_deg: float
    slope_sd_deg: float
    left: float
    readings: int
    spoilt: int


@dataclass(frozen=True, slots=True)
class _HeightReadings:
    """For each reading (n,): the contact and the pivot's position (m) and velocity (m/s), as reported."""

    s: FloatArray
    x: FloatArray
    z: FloatArray
    vx: FloatArray
    vz: FloatArray

    def select(self, which: npt.NDArray[np.bool_]) -> _HeightReadings:
        """The selected readings."""
        return _HeightReadings(*(each[which] for each in (self.s, self.x, self.z, self.vx, self.vz)))


def pivot_height(events: Iterable[Event], rig: PivotRig, radius_m: float) -> PivotHeight:
    """Error of the pivot's position from a daemon's events while the cylinder was dragged; raises HeightError."""
    readings = _read_events(events)
    if len(readings.s) < MIN_READINGS:
        raise HeightError(
            f"{len(readings.s)} readings of the pad between reports of the pivot's height, {MIN_READINGS} are needed:"
            " drag the cylinder over the pad for longer"
        )
    height_range = float(np.ptp(np.quantile(readings.z, (0.02, 0.98))))
    if height_range < MIN_HEIGHT_RANGE_M:
        raise HeightError(
            f"the pivot's height changed by only {height_range * 1e3:.2f} mm during contact: hold the cylinder"
            " 5 to 9 mm off its axis under a rigid gripper, and let it turn"
        )
    prior = np.array([np.inf] * 3 + [rig.pad.scale_sd, rig.angle_sd, rig.pad.sagitta_sd, rig.pad.lag_sd])
    x, kept = _initial_circle(readings, radius_m, len(prior))
    for _ in range(2):
        x, sd = _solve(x, readings.select(kept), rig, radius_m, prior)
        kept = inliers(_residuals(x, readings, rig, radius_m), min_scale=1.0)
    residual_rms = math.sqrt(float(np.mean(_residuals(x, readings.select(kept), rig, radius_m) ** 2)))
    if not residual_rms < MAX_RESIDUAL_RATIO:
        raise HeightError(
            f"the readings fit no cylinder (residual {residual_rms:.1f} times their noise): is it round, does it turn"
            " in the pivot only, and is the pad's counts_per_mm right?"
        )
    sd = sd * max(residual_rms, 1.0)
    if not sd[0] < MAX_SD_M:
        raise HeightError(
            f"the height is uncertain by {sd[0] * 1e6:.0f} µm: let the cylinder turn further, on both sides of the"
            " place where it touches below the pivot"
        )
    (height, along, off_axis), (height_sd, along_sd) = (x[:3] * 1e3).tolist(), (sd[:2] * 1e3).tolist()
    return PivotHeight(
        height, height_sd, along, along_sd, off_axis, math.degrees(x[4]), math.degrees(sd[4]), residual_rms,
        int(kept.sum()), int((~kept).sum()),
    )  # fmt: skip


def _read_events(events: Iterable[Event]) -> _HeightReadings:
    """All readings between two reports of the arm that are close in time."""
    ordered = sorted(events, key=lambda event: event.t_sample)
    arm = np.array(
        [(e.t_sample, *e.angles) for e in ordered if isinstance(e, PalmSample) and math.isfinite(e.angles[1])]
    )
    pad = np.array([(e.t_sample, e.s) for e in ordered if isinstance(e, PadSample)])
    if len(arm) < 2 or not len(pad):
        return _HeightReadings(*np.zeros((5, 0)))
    t, s = pad[(pad[:, 0] > arm[0, 0]) & (pad[:, 0] < arm[-1, 0])].T
    after = np.searchsorted(arm[:, 0], t)
    is_close = arm[after, 0] - arm[after - 1, 0] < MAX_GAP_S
    t, s = t[is_close], s[is_close]
    rates = np.gradient(arm[:, 1:], arm[:, 0], axis=0)
    x, z, vx, vz = (np.interp(t, arm[:, 0], column) for column in (*arm[:, 1:].T, *rates.T))
    return _HeightReadings(s, x, z, vx, vz)


def _initial_circle(readings: _HeightReadings, radius_m: float, count: int) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Initial circle by linear least squares, e² + z² = 2 e e0 + 2 z z0 + b² − e0² − z0² (Kåsa 1976); and inliers."""
    e, z = readings.s - readings.x, readings.z
    rows, squares = np.column_stack([2 * e, 2 * z, np.ones_like(e)]), e**2 + z**2
    kept = np.ones(len(e), dtype=np.bool_)
    for _ in range(_TRIMMING_ROUNDS):
        e0, z0, constant = np.linalg.lstsq(rows[kept], squares[kept], rcond=None)[0]
        b = math.sqrt(max(constant + e0**2 + z0**2, 0.0))
        kept = inliers(np.hypot(e - e0, z - z0) - b, min_scale=_MIN_SCALE_M)
    x = np.zeros(count)
    x[:3] = z0 - radius_m, e0, b
    return x, kept


def _residuals(x: FloatArray, readings: _HeightReadings, rig: PivotRig, radius_m: float) -> FloatArray:
    """Distance of each reading from the circle, over its 1σ in that direction (n,)."""
    height, along, b, scale, slope, bow, lag = x
    length = rig.pad.length
    s = readings.s / (1 + scale)
    share = s / length
    e = s - readings.x - along
    surface = slope * (s - length / 2) - bow * (1 - 2 * share) ** 2  # its height there, relative to the middle
    surface_slope = slope + 4 * bow / length * (1 - 2 * share)
    height_over_tangent = readings.z - height - radius_m - surface + surface_slope * e  # at the contact
    contact_speed = readings.vx - height_over_tangent * readings.vz * e / (e**2 + _NEAR_M**2)  # e ė = −(z − z0 − R) ż
    e = e + lag * contact_speed
    distance = np.hypot(e, height_over_tangent)
    variance = e**2 * (rig.pad.reading_variance + rig.arm_noise**2) + height_over_tangent**2 * rig.arm_noise**2
    sigma = np.sqrt(variance) / np.maximum(distance, 1e-9)
    return np.asarray((distance - b) / sigma)


def _solve(
    x: FloatArray, readings: _HeightReadings, rig: PivotRig, radius_m: float, prior: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The parameters and their 1σ; exactly known parameters stay."""
    free = prior > 0.0

    def complete(values: FloatArray) -> FloatArray:
        whole = x.copy()
        whole[free] = values
        return whole

    found = solved(
        lambda values: np.concatenate([_residuals(complete(values), readings, rig, radius_m), values / prior[free]]),
        x[free],
    )
    if not found.success:
        raise HeightError("no circle explains the readings: does the cylinder turn freely in the gripper?")
    sd = np.zeros_like(x)
    sd[free] = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    return complete(found.x), sd
