"""What a daemon estimates of a body between three palms against what its emulated rig knows to be true. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from palmd.events import FloatArray
from palmd.harness.settling import OutlineFigures, SettlingComparison
from palmd.model.icosphere import icosphere
from palmd.model.rotation import exp
from palmd.three_palms_quantities import PALM3, PALM3_BODY, PALM3_SHAPE, PALM3_TRUTH, WORLD_AXES

SPIN = tuple(f"omega_{axis}_rad_s" for axis in WORLD_AXES)
CENTRE = tuple(f"com_{axis}_m" for axis in WORLD_AXES)
TURNS = 6  # steps of Gauss–Newton towards the best turn
COMPARED = 120  # directions that are looked at, at most
REACH = 60  # directions next to one, for h between them


class ThreePalmsComparison(SettlingComparison):
    """Of three palms in space."""

    shape = "surface"
    normals = "directions"

    def __init__(self, seed: int, rig: str) -> None:
        super().__init__(seed, rig)
        self._turn: FloatArray | None = None  # from the estimate's frame to the truth's, when the shape came
        self._off: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=6000)  # in spin and centre, with bands

    def _take(self, topic: str, fields: Mapping[str, Any]) -> None:
        if topic == PALM3.name:
            self._take_estimate(fields)
        elif topic == PALM3_SHAPE.name and fields["valid"]:
            self._shape = fields
            if self._truth and math.isfinite(self._estimate["quat_xyzw"][0]):
                own, true = matrix(self._estimate["quat_xyzw"]), matrix(self._truth["quat_xyzw"])
                self._turn = true.T @ own
        elif topic == PALM3_TRUTH.name:
            self._truth = fields
        elif topic == PALM3_BODY.name:
            self._body = fields

    def _compare(self, estimate: Mapping[str, Any], truth: Mapping[str, Any]) -> None:
        names = (*SPIN, *CENTRE)
        off = np.array([estimate[name] - truth[name] for name in names])
        self._off.append((off, np.array([estimate["sd"][name] for name in names])))

    def _errors(self) -> list[str]:
        if not self._off:
            return []
        off, sd = (np.array(each) for each in zip(*self._off, strict=True))
        spin, centre = np.sqrt(np.mean(off[:, :3] ** 2)), np.sqrt(np.mean(off[:, 3:] ** 2))
        square = np.mean((off / sd) ** 2)
        return [f"omega {spin:.3f} rad/s, centre {centre * 1e6:.0f} µm RMS, (error/sd)² {square:.2f}"]

    def _outline(self) -> OutlineFigures | None:
        shape, body = self._shape, self._body
        if shape is None or body is None or self._turn is None or shape["object"] != self._estimate.get("object"):
            return None
        return OutlineFigures(*surface_error(shape, np.array(body["h_m"]), self._turn))


def matrix(quaternion: tuple[float, ...]) -> FloatArray:
    """(3, 3) of x, y, z, w."""
    x, y, z, w = quaternion
    v = np.array([x, y, z])
    half = np.linalg.norm(v)
    return exp(v * (0.0 if half == 0.0 else 2.0 * math.atan2(half, w) / half))


def surface_error(shape: Mapping[str, Any], true: FloatArray, turn: FloatArray) -> tuple[float, float, float]:
    """(RMS error of h where touched (m) after the best turn near `turn`, RMS of its band there, share touched).

    Some of the touched directions, all over, are looked at.

    true: h in the directions of the icosphere, in a frame that the estimate's is brought to by `turn`.
    """
    directions, _ = icosphere()
    touched = np.array(shape["touched"]) > 0
    felt = np.flatnonzero(touched)
    some = felt[:: max(1, -(-len(felt) // COMPARED))]
    h, sd = np.array(shape["h_m"])[some], np.array(shape["h_sd_m"])[some]
    u: FloatArray = np.asarray(directions[some] @ turn.T, np.float64)
    for _ in range(TURNS):
        near, slope = between(true, u)
        step: FloatArray = np.asarray(np.linalg.lstsq(np.cross(u, slope), h - near, rcond=None)[0], np.float64)
        u = np.asarray(u @ exp(step).T, np.float64)
    off = h - between(true, u)[0]
    return float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(sd**2))), float(touched.mean())


def between(h: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(h (T,), its slope (T, 3) along the sphere) at unit vectors u (T, 3), by a cubic through those about."""
    directions, _ = icosphere()
    values, slopes = np.empty(len(u)), np.empty((len(u), 3))
    for i, each in enumerate(u):
        close = directions @ each
        some = np.argpartition(-close, REACH)[:REACH]
        one = np.cross(each, np.eye(3)[np.abs(each).argmin()])
        one /= np.linalg.norm(one)
        other = np.cross(each, one)
        x, y = directions[some] @ one, directions[some] @ other
        rows = np.stack([x**j * y**k for j in range(5) for k in range(5 - j)], axis=1)
        weight = np.exp(-0.5 * (np.hypot(x, y) / 0.15) ** 2)
        found = np.linalg.lstsq(weight[:, None] * rows, weight * h[some], rcond=None)[0]
        values[i], slopes[i] = found[0], found[5] * one + found[1] * other
    return values, slopes
