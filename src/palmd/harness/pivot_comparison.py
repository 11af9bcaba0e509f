"""Comparison of a daemon's estimates of a pivoting grasp with the truth of its emulated rig. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from palmd.harness.comparison import OutlineFigures, SettlingComparison
from palmd.pivot_quantities import PIVOT, PIVOT_BODY, PIVOT_SHAPE, PIVOT_TRUTH
from palmd.score import score_shape


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
