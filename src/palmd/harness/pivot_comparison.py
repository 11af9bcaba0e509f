"""What a daemon estimates of a pivoting grasp against what its emulated rig knows to be true. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from palmd.bus.subscriber import Message
from palmd.quantities import PIVOT, PIVOT_BODY, PIVOT_SHAPE, PIVOT_TRUTH
from palmd.score import score_shape

LOOPS = 300
NEAR_S = 6e-3


class PivotComparison:
    """As `harness.comparison.Comparison`: takes the messages of both, and says in words what has come of it."""

    def __init__(self, seed: int, rig: str) -> None:
        """The rig's `seed`, and how far off it is, in words: to be named in the summary."""
        self.t_started: float | None = None
        self._seed, self._rig = seed, rig
        self._t_settled: float | None = None
        self._estimate: Mapping[str, Any] = {}
        self._state: Mapping[str, Any] = {}
        self._truth: Mapping[str, Any] | None = None
        self._body: Mapping[str, Any] | None = None
        self._shape: Mapping[str, Any] | None = None
        self._mu = (math.nan, math.nan)
        self._rates: deque[float] = deque(maxlen=6000)
        self._ticks = self._valid = 0
        self._most_n = 0.0
        self._work_ms: deque[float] = deque(maxlen=LOOPS)

    @property
    def settled(self) -> bool:
        """Whether an estimate has been called valid since the gripper began to move."""
        return self._t_settled is not None

    def started(self, t: float) -> None:
        """The gripper begins to move at t (s, monotonic clock), for the first time or again."""
        if self.t_started is None:
            self.t_started = t

    def take(self, message: Message) -> None:
        """One message of the daemon or of the rig."""
        fields = message.fields
        if message.topic == PIVOT.name:
            self._take_estimate(fields)
        elif message.topic == PIVOT_SHAPE.name:
            self._shape = fields
        elif message.topic == PIVOT_TRUTH.name:
            self._truth = fields
            self._most_n = max(self._most_n, fields["f1_n"])
        elif message.topic == PIVOT_BODY.name:
            self._body = fields
        elif message.topic == "palm/state":
            self._state = fields
        elif message.topic == "palm/loop":
            self._work_ms.append(fields["work_p99_ms"])

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
        """How it stands at t (s), in one line."""
        since = 0.0 if self.t_started is None else t - self.t_started
        estimate, state = self._estimate, self._state
        known = "valid" if estimate.get("valid") else f"not valid: {estimate.get('reason', 'nothing is heard')}"
        parts = [f"{since:5.1f} s", str(state.get("state", "")), known, *self._outline()]
        return ", ".join([*parts, str(state.get("reason", ""))])

    def summary(self) -> str:
        """The one line at the end."""
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
            f"work p99 {float(np.median(self._work_ms or [math.nan])):.1f} ms",
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
