"""True coverage of an exploration, from the rig's truth, tick by tick. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palmd.events import FloatArray
from palmd.messages import Fields
from palmd.motion.rollout_predictor import BINS, Bools
from palmd.quantities import ESTIMATE, SHAPE
from palmd.score import OutlineScore, score_shape, support_at
from palmd.system.arcs import FLAT, tangents
from palmd.system.mechanism import JOINTS, PALMS, normal_directions
from tools.closed_loop import Instant

EDGE_M = 5e-4
"""A contact that is nearer than this to a pad's end has reached it (m)."""

ENOUGH = 0.95
_BIN_RAD = math.tau / BINS


@dataclass(slots=True)
class ExplorationStatistics:
    """Statistics of an exploration; `reachable` and `touched` are marks on the truth's bins of outward normals.

    `curvatures` of the palms (1/m): normals are those of the tangents at the contacts. t_enough: when the coverage of
    the reachable normals reached `ENOUGH`; t_valid: the first valid tick (s since the start); NaN if never.
    """

    reachable: Bools
    pad_lengths_m: tuple[float, ...]
    t_start: float
    curvatures: Sequence[float] = FLAT
    touched: Bools = field(default_factory=lambda: np.zeros(BINS, dtype=np.bool_))
    t_enough: float = math.nan
    t_valid: float = math.nan
    valid: bool = False
    on_both: bool = False
    at_edge: int = 0  # ticks
    parted: int = 0  # ticks
    shape: Fields | None = None

    def take(self, instant: Instant) -> None:
        """Take one tick."""
        t, truth = instant.t - self.t_start, instant.truth
        self._touch(truth)
        estimate = instant.messages[ESTIMATE.name]
        self.valid = bool(estimate["valid"])
        if self.valid:
            self.t_valid = t if math.isnan(self.t_valid) else self.t_valid
            self.shape = instant.messages.get(SHAPE.name, self.shape)
        if math.isnan(self.t_enough) and self.coverage >= ENOUGH:
            self.t_enough = t

    @property
    def coverage(self) -> float:
        """The touched share of the reachable normals."""
        return float((self.touched & self.reachable).sum() / max(self.reachable.sum(), 1))

    def outline_score(self, true_h: FloatArray) -> OutlineScore | None:
        """Errors of the last valid outline on all normals, touched or not, after the best rotation.

        For convex bodies `max_error` is the Hausdorff distance (m).
        """
        if self.shape is None:
            return None
        return score_shape(self.shape, true_h, all_normals=True)

    def largest_sigmas(self, true_h: FloatArray) -> float:
        """Largest error of the last valid outline over its 1σ at that normal, NaN without an outline; see above."""
        score = self.outline_score(true_h)
        if score is None or self.shape is None:
            return math.nan
        theta, h, sd = (np.array(self.shape[name], dtype=np.float64) for name in ("theta_rad", "h_m", "h_sd_m"))
        return float(np.max(np.abs(h - support_at(true_h, theta + score.rotation)) / sd))

    def _touch(self, truth: dict[str, Any]) -> None:
        self.on_both = all(truth[f"contact{palm}"] for palm in PALMS)
        self.parted += not self.on_both
        contacts = [truth[f"s{number}_m"] for number in PALMS]
        joints = tangents([truth[f"{joint}_rad"] for joint in JOINTS], contacts, self.curvatures)
        normals = normal_directions(joints, truth["psi_rad"])
        for number, theta, length_m in zip(PALMS, normals, self.pad_lengths_m, strict=True):
            if truth[f"contact{number}"]:
                self.touched[math.floor(theta / _BIN_RAD) % BINS] = True
                s = truth[f"s{number}_m"]
                self.at_edge += not EDGE_M < s < length_m - EDGE_M
