"""What a daemon estimates of a pivoting grasp against what its emulated rig knows to be true. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from palmd.harness.comparison import AnyComparison
from palmd.quantities import PIVOT, PIVOT_BODY, PIVOT_SHAPE, PIVOT_TRUTH
from palmd.score import score_shape

NEAR_S = 6e-3


class PivotComparison(AnyComparison):
    """Of a pivoting grasp."""

    def __init__(self, seed: int, rig: str) -> None:
        super().__init__(seed, rig)
        self._t_settled: float | None = None
        self._estimate: Mapping[str, Any] = {}
        self._truth: Mapping[str, Any] | None = None
        self._body: Mapping[str, Any] | None = None
        self._shape: Mapping[str, Any] | None = None
        self._mu = (math.nan, math.nan)
        self._rates: deque[float] = deque(maxlen=6000)
        self._ticks = self._valid = 0
        self._most_n = 0.0

    @property
    def settled(self) -> bool:
        """By what is published."""
        return self._t_settled is not None

    def _take(self, topic: str, fields: Mapping[str, Any]) -> None:
        if topic == PIVOT.name:
            self._take_estimate(fields)
        elif topic == PIVOT_SHAPE.name:
            self._shape = fields
        elif topic == PIVOT_TRUTH.name:
            self._truth = fields
            self._most_n = max(self._most_n, fields["f1_n"])
        elif topic == PIVOT_BODY.name:
            self._body = fields

    def _take_estimate(self, fields: Mapping[str, Any]) -> None:
        self._ticks += 1
        self._estimate = fields
        if math.isfinite(fields["mu"]):
            self._mu = fields["mu"], fields["sd"]["mu"]
        if not fields["valid"] or self.t_started is None:
            return
        self._valid += 1
        t, truth = fields["mono_ns"] * 1e-9, self._truth
        if self._t_settled is None:
            self._t_settled = t
        if truth is not None and abs(truth["mono_ns"] * 1e-9 - t) < NEAR_S and truth["touch1"]:
            self._rates.append(fields["omega0_rad_s"] - truth["omega0_rad_s"])

    def progress(self, t: float) -> str:
        """One line, with why it is where it is."""
        since = 0.0 if self.t_started is None else t - self.t_started
        estimate, state = self._estimate, self._state
        known = "valid" if estimate.get("valid") else f"not valid: {estimate.get('reason', 'nothing is heard')}"
        parts = [f"{since:5.1f} s", str(state.get("state", "")), known, *self._outline()]
        return ", ".join([*parts, str(state.get("reason", ""))])

    def summary(self) -> str:
        """The closing line."""
        if self._t_settled is None or self.t_started is None:
            settled = f"never settled: {self._estimate.get('reason', 'nothing is heard')}"
        else:
            settled = f"settled after {self._t_settled - self.t_started:.1f} s"
        parts = [f"seed {self._seed}", f"rig {self._rig}", settled, *self._outline()]
        if self._rates:
            parts.append(f"omega0 {float(np.sqrt(np.mean(np.square(self._rates)))):.3f} rad/s")
        if self._body is not None and math.isfinite(self._mu[0]):
            parts.append(f"mu {self._mu[0]:.3f} ± {self._mu[1]:.3f} (true {self._body['mu']:.3f})")
        parts += [
            f"largest force {self._most_n:.2f} N",
            f"ticks {self._ticks}, valid {self._valid}",
            self._work(),
        ]
        return "palmd demo: " + ", ".join(parts)

    def _outline(self) -> list[str]:
        shape, body = self._shape, self._body
        if shape is None or body is None or not any(shape["touched"]):
            return []
        mine = {"theta_rad": shape["theta_rad"], "h_m": shape["hP_m"], "touched": shape["touched"]}
        score = score_shape(mine, body["hP_m"], all_normals=False)
        sd, touched = np.array(shape["hP_sd_m"]), np.array(shape["touched"]) > 0
        band = math.sqrt(np.mean(sd[touched] ** 2))
        off, share = score.e_h * 1e6, score.touched
        return [f"outline about the pivot {off:.0f} µm RMS on {share:.0%} touched normals (sd {band * 1e6:.0f} µm)"]
