"""Comparisons of estimates of a pivoting grasp, and of a body between three palms, with their rigs' truth. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from palmd.events import FloatArray
from palmd.harness.comparison import OutlineFigures, SettlingComparison
from palmd.model.icosphere import icosphere
from palmd.model.rotation import exp
from palmd.pivot_quantities import PIVOT, PIVOT_BODY, PIVOT_SHAPE, PIVOT_TRUTH
from palmd.score import score_shape
from palmd.three_palms_quantities import PALM3, PALM3_BODY, PALM3_SHAPE, PALM3_TRUTH, WORLD_AXES


class PivotComparison(SettlingComparison):
    """Comparison for a pivoting grasp."""

    shape = "outline about the pivot"
    normals = "normals"
    explored = "the ends"

    def __init__(self, seed: int, rig: str) -> None:
        super().__init__(seed, rig)
        self._rates: deque[float] = deque(maxlen=6000)
        self._largest_n = 0.0

    def _take(self, topic: str, fields: Mapping[str, Any]) -> None:
        if topic == PIVOT.name:
            self._take_estimate(fields)
        elif topic == PIVOT_SHAPE.name:
            self._shape = fields
        elif topic == PIVOT_TRUTH.name:
            self._truth = fields
            self._largest_n = max(self._largest_n, fields["f1_n"])
        elif topic == PIVOT_BODY.name:
            self._body = fields

    def _compare(self, estimate: Mapping[str, Any], truth: Mapping[str, Any]) -> None:
        if truth["touch1"]:
            self._rates.append(estimate["omega0_rad_s"] - truth["omega0_rad_s"])

    def _errors(self) -> list[str]:
        force = f"largest force {self._largest_n:.2f} N"
        if not self._rates:
            return [force]
        return [f"omega0 {float(np.sqrt(np.mean(np.square(self._rates)))):.3f} rad/s", force]

    def _outline(self) -> OutlineFigures | None:
        shape, body = self._shape, self._body
        if shape is None or body is None or not any(shape["touched"]):
            return None
        estimated = {"theta_rad": shape["theta_rad"], "h_m": shape["hP_m"], "touched": shape["touched"]}
        score = score_shape(estimated, body["hP_m"], all_normals=False)
        sd, touched = np.array(shape["hP_sd_m"]), np.array(shape["touched"]) > 0
        return OutlineFigures(score.e_h, math.sqrt(np.mean(sd[touched] ** 2)), score.touched)


SPIN = tuple(f"omega_{axis}_rad_s" for axis in WORLD_AXES)
CENTRE = tuple(f"com_{axis}_m" for axis in WORLD_AXES)
ROTATION_STEPS = 6  # Gauss–Newton steps for the best rotation
MAX_DIRECTIONS = 120  # largest number of directions compared
NEIGHBOURS = 60  # neighbouring directions used for interpolating h


class ThreePalmsComparison(SettlingComparison):
    """Comparison for three palms in space."""

    shape = "surface"
    normals = "directions"
    explored = "all directions to within 10°"

    def __init__(self, seed: int, rig: str) -> None:
        super().__init__(seed, rig)
        self._rotation: FloatArray | None = None  # from the estimate's frame to the true one, at the time of the shape
        self._deviations: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=6000)  # of spin and centre, with sds

    def _take(self, topic: str, fields: Mapping[str, Any]) -> None:
        if topic == PALM3.name:
            self._take_estimate(fields)
        elif topic == PALM3_SHAPE.name and fields["valid"]:
            self._shape = fields
            if self._truth and math.isfinite(self._estimate["quat_xyzw"][0]):
                own, true = matrix(self._estimate["quat_xyzw"]), matrix(self._truth["quat_xyzw"])
                self._rotation = true.T @ own
        elif topic == PALM3_TRUTH.name:
            self._truth = fields
        elif topic == PALM3_BODY.name:
            self._body = fields

    def _compare(self, estimate: Mapping[str, Any], truth: Mapping[str, Any]) -> None:
        names = (*SPIN, *CENTRE)
        deviation = np.array([estimate[name] - truth[name] for name in names])
        self._deviations.append((deviation, np.array([estimate["sd"][name] for name in names])))

    def _errors(self) -> list[str]:
        if not self._deviations:
            return []
        deviations, sd = (np.array(each) for each in zip(*self._deviations, strict=True))
        spin, centre = np.sqrt(np.mean(deviations[:, :3] ** 2)), np.sqrt(np.mean(deviations[:, 3:] ** 2))
        square = np.mean((deviations / sd) ** 2)
        return [f"omega {spin:.3f} rad/s, centre {centre * 1e6:.0f} µm RMS, (error/sd)² {square:.2f}"]

    def _outline(self) -> OutlineFigures | None:
        shape, body = self._shape, self._body
        if shape is None or body is None or self._rotation is None or shape["object"] != self._estimate.get("object"):
            return None
        return OutlineFigures(*surface_error(shape, np.array(body["h_m"]), self._rotation))


def matrix(quaternion: tuple[float, ...]) -> FloatArray:
    """Rotation matrix (3, 3) of a quaternion x, y, z, w."""
    x, y, z, w = quaternion
    v = np.array([x, y, z])
    half = np.linalg.norm(v)
    return exp(v * (0.0 if half == 0.0 else 2.0 * math.atan2(half, w) / half))


def surface_error(shape: Mapping[str, Any], true: FloatArray, rotation: FloatArray) -> tuple[float, float, float]:
    """(RMS error of h (m), RMS of its standard deviation, fraction touched), on touched directions.

    The error is that after the best rotation near `rotation`. At most `MAX_DIRECTIONS` directions are used, evenly
    chosen.

    true: h in the directions of the icosphere, in a frame to which `rotation` maps the estimate's.
    """
    directions, _ = icosphere()
    touched = np.array(shape["touched"]) > 0
    touched_indices = np.flatnonzero(touched)
    chosen = touched_indices[:: max(1, -(-len(touched_indices) // MAX_DIRECTIONS))]
    h, sd = np.array(shape["h_m"])[chosen], np.array(shape["h_sd_m"])[chosen]
    u: FloatArray = np.asarray(directions[chosen] @ rotation.T, np.float64)
    for _ in range(ROTATION_STEPS):
        interpolated, slope = between(true, u)
        step: FloatArray = np.asarray(np.linalg.lstsq(np.cross(u, slope), h - interpolated, rcond=None)[0], np.float64)
        u = np.asarray(u @ exp(step).T, np.float64)
    error = h - between(true, u)[0]
    return float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(sd**2))), float(touched.mean())


def between(h: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(h (T,), its slope (T, 3) along the sphere) at unit vectors u (T, 3), by a local cubic fit."""
    directions, _ = icosphere()
    values, slopes = np.empty(len(u)), np.empty((len(u), 3))
    for i, each in enumerate(u):
        cosines = directions @ each
        nearest = np.argpartition(-cosines, NEIGHBOURS)[:NEIGHBOURS]
        axis1 = np.cross(each, np.eye(3)[np.abs(each).argmin()])
        axis1 /= np.linalg.norm(axis1)
        axis2 = np.cross(each, axis1)
        x, y = directions[nearest] @ axis1, directions[nearest] @ axis2
        rows = np.stack([x**j * y**k for j in range(5) for k in range(5 - j)], axis=1)
        weight = np.exp(-0.5 * (np.hypot(x, y) / 0.15) ** 2)
        fit = np.linalg.lstsq(weight[:, None] * rows, weight * h[nearest], rcond=None)[0]
        values[i], slopes[i] = fit[0], fit[5] * axis1 + fit[1] * axis2
    return values, slopes
