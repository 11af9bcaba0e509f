"""Errors of estimates against the truth, tick by tick: settling time, final errors, and the outline. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palmd.score import LAST_S, OutlineScore, score_shape
from palmd.system.mechanism import RADII

COMPARED = (*(f"{name}_m" for name in RADII), "omega0_rad_s")
"""Fields compared with the truth at each valid tick."""

_NOTHING = dict.fromkeys(("rho_m", "mu", "mass_kg"), math.nan)


class Scorer:
    """Processes every estimate, and the truth of the valid ones; memory does not grow with the duration."""

    def __init__(self, t_started: float | None = None) -> None:
        """The palms began to move at `t_started` (s); None: not yet."""
        self.t_started = t_started
        self.t_settled: float | None = None
        self.estimate: Mapping[str, Any] = {}
        self.shape: Mapping[str, Any] | None = None
        self._last_valid: Mapping[str, Any] = _NOTHING
        self._errors: deque[tuple[float, ...]] = deque()  # t and the errors of `COMPARED`, the last `LAST_S`

    def take(self, t: float, estimate: Mapping[str, Any]) -> bool:
        """Process a palm/estimate at t (s); returns whether its truth is needed: valid, and the palms have moved."""
        self.estimate = estimate
        while self._errors and self._errors[0][0] <= t - LAST_S:
            self._errors.popleft()
        counts = bool(estimate["valid"]) and self.t_started is not None and t >= self.t_started
        if counts:
            self.t_settled = t if self.t_settled is None else self.t_settled
            self._last_valid = estimate
        return counts

    def take_shape(self, shape: Mapping[str, Any]) -> None:
        """Process a palm/shape: it belongs to the estimate before it."""
        if self.estimate.get("valid"):
            self.shape = shape

    def compare(self, t: float, estimated: Sequence[float], true: Sequence[float]) -> None:
        """Estimated and true values of `COMPARED` at the valid tick of time t (s)."""
        errors = [a - b for a, b in zip(estimated, true, strict=True)]
        self._errors.append((t, *errors))

    @property
    def settling_s(self) -> float:
        """Time from the begin of motion to the first valid tick (s), NaN if there is none."""
        return math.nan if self.t_settled is None or self.t_started is None else self.t_settled - self.t_started

    def rms(self) -> tuple[float, float]:
        """RMS error of all radii (m) and of ω0 (rad/s), over the valid ticks of the last `LAST_S`."""
        if not self._errors:
            return math.nan, math.nan
        _, *radii, omega0 = np.mean(np.square(self._errors), axis=0).tolist()
        return math.sqrt(sum(radii) / len(radii)), math.sqrt(omega0)

    def constants(self, true: Mapping[str, Any]) -> tuple[float, float, float]:
        """Errors of the last valid tick against a rig/object: relative for ρ and mass, absolute for μ."""
        estimated = self._last_valid
        return (
            estimated["rho_m"] / true["rho_m"] - 1.0,
            estimated["mu"] - true["mu"],
            estimated["mass_kg"] / true["mass_kg"] - 1.0,
        )

    def outline(self, true_h: Sequence[float], *, all_normals: bool = False) -> OutlineScore | None:
        """The score of the last valid outline; None if there is none or it has no touched normal."""
        if self.shape is None or not any(self.shape["touched"]):
            return None
        return score_shape(self.shape, true_h, all_normals=all_normals)
