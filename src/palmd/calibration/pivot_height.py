"""How far a gripper's pivot is off the place that is told of it, from a cylinder that it drags over the pad. Pure.

A cylinder of radius R that is held some way b off its axis has h_P = R + b cos(θ − θ0). What touch tells of it, the
lever e = h_P′ and the height z = h_P, lies on a circle,

    (e − along)² + (z − height − R)² = b²,

whose middle would be at (0, R) if all were as told. Neither force nor friction nor how the cylinder was turned has a
part in it. By Gauss–Newton in (height, along, b) and in what else moves the readings, each as well known beforehand as
it is configured: the pad's scale, its slope along the arm's x, its bow, and how late it tells.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.calibration.cylinder import not_spoilt
from palmd.events import Event, FloatArray, PadSample, PalmSample
from palmd.system.pivot import PivotRig

APART_S = 0.05  # of the arm's reports around a reading, at most
LEAST_READINGS = 200
LEAST_WAY_M = 1e-3  # of the height
LARGEST_SD_M = 5e-5  # of the height, beyond which nothing is told
MOST_LEFT = 2.0  # times what the readings' noise allows
_STEPS = np.array([1e-7, 1e-7, 1e-7, 1e-5, 1e-6, 1e-7, 1e-5])  # of the differences
_ROUNDS, _SETTLED_M = 30, 1e-8
_TRIMMED, _ROUGHLY_M = 5, 1e-4  # rounds without what is far from the circle, and what is near it in any case
_NEAR_M = 1e-3  # of the lever, below which it says little of how fast the contact runs


class HeightError(ValueError):
    """The readings do not tell the height; the text says why and what to do."""


@dataclass(frozen=True, slots=True)
class PivotHeight:
    """What is told of the pivot less what is true, over the pad's middle and along it (mm), with one sigma.

    off_axis_mm: how far off its axis the cylinder was held. slope_deg: by how much the pad rises along the arm's x.
    left: of each reading, over what its noise allows.
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
class _Dragged:
    """At each reading (n,): the contact and the pivot's place (m) and its velocity (m/s), as told."""

    s: FloatArray
    x: FloatArray
    z: FloatArray
    vx: FloatArray
    vz: FloatArray

    def some(self, which: npt.NDArray[np.bool_]) -> _Dragged:
        """Those readings."""
        return _Dragged(*(each[which] for each in (self.s, self.x, self.z, self.vx, self.vz)))


def pivot_height(events: Iterable[Event], rig: PivotRig, radius_m: float) -> PivotHeight:
    """From what a daemon was fed while the cylinder was dragged; raises HeightError where that does not suffice."""
    felt = _dragged(events)
    if len(felt.s) < LEAST_READINGS:
        raise HeightError(
            f"{len(felt.s)} readings of the pad where the arm tells the pivot's height, and it takes {LEAST_READINGS}:"
            " drag the cylinder over the pad for longer"
        )
    went = float(np.ptp(np.quantile(felt.z, (0.02, 0.98))))
    if went < LEAST_WAY_M:
        raise HeightError(
            f"the pivot's height changed by {went * 1e3:.2f} mm only while the cylinder touched: hold it off its axis,"
            " by 5 to 9 mm under a rigid gripper, and let it turn"
        )
    prior = np.array([np.inf] * 3 + [rig.pad.scale_sd, rig.angle_sd, rig.pad.sagitta_sd, rig.pad.lag_sd])
    x, kept = _begun(felt, radius_m, len(prior))
    for _ in range(2):
        x = _solved(x, felt.some(kept), rig, radius_m, prior)
        kept = not_spoilt(_left(x, felt, rig, radius_m), least=1.0)
    left = math.sqrt(float(np.mean(_left(x, felt.some(kept), rig, radius_m) ** 2)))
    if not left < MOST_LEFT:
        raise HeightError(
            f"the readings follow no cylinder ({left:.1f} times what their noise allows is left of them): is it round,"
            " does it turn in the pivot alone, and is the pad's counts_per_mm right?"
        )
    sd = _sd(x, felt.some(kept), rig, radius_m, prior) * max(left, 1.0)
    if not sd[0] < LARGEST_SD_M:
        raise HeightError(
            f"the height is told to {sd[0] * 1e6:.0f} µm only: the cylinder has to turn by more, on both sides of the"
            " place where it touches under the pivot"
        )
    (height, along, off_axis), (height_sd, along_sd) = (x[:3] * 1e3).tolist(), (sd[:2] * 1e3).tolist()
    return PivotHeight(
        height, height_sd, along, along_sd, off_axis, math.degrees(x[4]), math.degrees(sd[4]), left,
        int(kept.sum()), int((~kept).sum()),
    )  # fmt: skip


def _dragged(events: Iterable[Event]) -> _Dragged:
    """All readings between two reports of the arm that are not far apart."""
    ordered = sorted(events, key=lambda event: event.t_sample)
    arm = np.array(
        [(e.t_sample, *e.angles) for e in ordered if isinstance(e, PalmSample) and math.isfinite(e.angles[1])]
    )
    pad = np.array([(e.t_sample, e.s) for e in ordered if isinstance(e, PadSample)])
    if len(arm) < 2 or not len(pad):
        return _Dragged(*np.zeros((5, 0)))
    t, s = pad[(pad[:, 0] > arm[0, 0]) & (pad[:, 0] < arm[-1, 0])].T
    at = np.searchsorted(arm[:, 0], t)
    near = arm[at, 0] - arm[at - 1, 0] < APART_S
    t, s = t[near], s[near]
    rates = np.gradient(arm[:, 1:], arm[:, 0], axis=0)
    x, z, vx, vz = (np.interp(t, arm[:, 0], of) for of in (*arm[:, 1:].T, *rates.T))
    return _Dragged(s, x, z, vx, vz)


def _begun(felt: _Dragged, radius_m: float, count: int) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """The circle by linear least squares, e² + z² = 2 e e0 + 2 z z0 + b² − e0² − z0² (Kåsa 1976); what is on it."""
    e, z = felt.s - felt.x, felt.z
    rows, squares = np.column_stack([2 * e, 2 * z, np.ones_like(e)]), e**2 + z**2
    kept = np.ones(len(e), dtype=np.bool_)
    for _ in range(_TRIMMED):
        e0, z0, rest = np.linalg.lstsq(rows[kept], squares[kept], rcond=None)[0]
        b = math.sqrt(max(rest + e0**2 + z0**2, 0.0))
        kept = not_spoilt(np.hypot(e - e0, z - z0) - b, least=_ROUGHLY_M)
    x = np.zeros(count)
    x[:3] = z0 - radius_m, e0, b
    return x, kept


def _left(x: FloatArray, felt: _Dragged, rig: PivotRig, radius_m: float) -> FloatArray:
    """How far each reading is from the circle, over its one-sigma in that direction (n,)."""
    height, along, b, scale, slope, bow, late = x
    length = rig.pad.length
    s = felt.s / (1 + scale)
    share = s / length
    e = s - felt.x - along
    rises = slope * (s - length / 2) - bow * (1 - 2 * share) ** 2  # the surface there, over its middle
    tilted = slope + 4 * bow / length * (1 - 2 * share)
    up = felt.z - height - radius_m - rises + tilted * e  # over the tangent where it touches
    runs = felt.vx - up * felt.vz * e / (e**2 + _NEAR_M**2)  # of the contact: e ė = −(z − z0 − R) ż on the circle
    e = e + late * runs
    far = np.hypot(e, up)
    variance = e**2 * (rig.pad.reading_variance + rig.arm_noise**2) + up**2 * rig.arm_noise**2
    sigma = np.sqrt(variance) / np.maximum(far, 1e-9)
    return np.asarray((far - b) / sigma)


def _gradient(x: FloatArray, felt: _Dragged, rig: PivotRig, radius_m: float) -> FloatArray:
    columns = [
        (_left(x + step, felt, rig, radius_m) - _left(x - step, felt, rig, radius_m)) / (2 * step.max())
        for step in np.diag(_STEPS)
    ]
    return np.stack(columns, axis=1)


def _solved(x: FloatArray, felt: _Dragged, rig: PivotRig, radius_m: float, prior: FloatArray) -> FloatArray:
    free = prior > 0.0  # what is known exactly stays
    for _ in range(_ROUNDS):
        rows, left = _with_prior(x, felt, rig, radius_m, prior)
        step = np.zeros_like(x)
        step[free] = -np.linalg.lstsq(rows[:, free], left, rcond=None)[0]
        x = x + step
        if not np.isfinite(x).all():
            break
        if np.abs(step[:3]).max() < _SETTLED_M:
            return x
    raise HeightError("no circle explains the readings: does the cylinder turn freely in the gripper?")


def _with_prior(
    x: FloatArray, felt: _Dragged, rig: PivotRig, radius_m: float, prior: FloatArray
) -> tuple[FloatArray, FloatArray]:
    known = np.where((prior > 0.0) & np.isfinite(prior), 1.0 / np.maximum(prior, 1e-12), 0.0)
    rows = np.vstack([_gradient(x, felt, rig, radius_m), np.diag(known)])
    return rows, np.concatenate([_left(x, felt, rig, radius_m), known * x])


def _sd(x: FloatArray, felt: _Dragged, rig: PivotRig, radius_m: float, prior: FloatArray) -> FloatArray:
    free = prior > 0.0
    rows, _ = _with_prior(x, felt, rig, radius_m, prior)
    sd = np.zeros_like(x)
    sd[free] = np.sqrt(np.diag(np.linalg.inv(rows[:, free].T @ rows[:, free])))
    return sd
