"""Estimates against the truth, tick by tick: settled when, how far off at the end, and the outline. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palmd.score import LAST_S, WRONG_M, OutlineScore, score_shape
from palmd.system.mechanism import RADII

COMPARED = (*(f"{name}_m" for name in RADII), "omega0_rad_s")
"""What is compared with the truth at each valid tick."""

_NOTHING = dict.fromkeys(("rho_m", "mu", "mass_kg"), math.nan)


class Scorer:
    """Takes every estimate and the truth of the valid ones; needs the same memory however long a run is."""

    def __init__(self, t_started: float | None = None) -> None:
        """The palms began to move at `t_started` (s); None: they do not yet."""
        self.t_started = t_started
        self.t_settled: float | None = None
        self.estimate: Mapping[str, Any] = {}
        self.shape: Mapping[str, Any] | None = None
        self._last_valid: Mapping[str, Any] = _NOTHING
        self._ticks = self._valid = self._wrong = 0
        self._errors: deque[tuple[float, ...]] = deque()  # t and the errors of `COMPARED`, the last `LAST_S`

    def take(self, t: float, estimate: Mapping[str, Any]) -> bool:
        """Every palm/estimate, at t (s); whether its truth is wanted: it is valid, and the palms have begun to move."""
        self.estimate = estimate
        while self._errors and self._errors[0][0] <= t - LAST_S:
            self._errors.popleft()
        counts = bool(estimate["valid"]) and self.t_started is not None and t >= self.t_started
        if counts:
            self.t_settled = t if self.t_settled is None else self.t_settled
            self._last_valid = estimate
            self._valid += 1
        self._ticks += self.t_settled is not None
        return counts

    def take_shape(self, shape: Mapping[str, Any]) -> None:
        """Every palm/shape: it belongs to the estimate before it."""
        if self.estimate.get("valid"):
            self.shape = shape

    def compare(self, t: float, estimated: Sequence[float], true: Sequence[float]) -> None:
        """The values of `COMPARED` at t (s) of a valid tick, and their truth."""
        errors = [a - b for a, b in zip(estimated, true, strict=True)]
        self._errors.append((t, *errors))
        self._wrong += max(map(abs, errors[: len(RADII)])) > WRONG_M

    @property
    def settling_s(self) -> float:
        """From the motion's beginning to the first valid tick (s), NaN when there is none."""
        return math.nan if self.t_settled is None or self.t_started is None else self.t_settled - self.t_started

    @property
    def valid_share(self) -> float:
        """Of the ticks since the first valid one."""
        return _share(self._valid, self._ticks)

    @property
    def wrong_share(self) -> float:
        """Of the valid ticks: a radius is off by more than `WRONG_M`."""
        return _share(self._wrong, self._valid)

    def rms(self) -> tuple[float, float]:
        """Of the radii together (m), and of ω0 (rad/s), over the valid ticks of the last `LAST_S`."""
        if not self._errors:
            return math.nan, math.nan
        _, *radii, omega0 = np.mean(np.square(self._errors), axis=0).tolist()
        return math.sqrt(sum(radii) / len(radii)), math.sqrt(omega0)

    def constants(self, true: Mapping[str, Any]) -> tuple[float, float, float]:
        """Errors of the last valid tick against a rig/object: of ρ and mass relative, of μ absolute."""
        mine = self._last_valid
        return mine["rho_m"] / true["rho_m"] - 1.0, mine["mu"] - true["mu"], mine["mass_kg"] / true["mass_kg"] - 1.0

    def outline(self, true_h: Sequence[float], *, all_normals: bool = False) -> OutlineScore | None:
        """The last valid outline's score; None when there is none, or nothing of it was touched."""
        if self.shape is None or not any(self.shape["touched"]):
            return None
        return score_shape(self.shape, true_h, all_normals=all_normals)


def _share(part: int, whole: int) -> float:
    return part / whole if whole else math.nan
