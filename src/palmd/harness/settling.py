"""Comparison of estimates that carry the daemon's own reason when they are invalid. Pure."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from palmd.harness.comparison import AnyComparison
from palmd.harness.object_losses import ObjectLosses

NEAR_S = 6e-3  # largest time difference of an estimate and the truth that it is compared with


class OutlineFigures(NamedTuple):
    """Of the estimated shape on touched normals: RMS error (m), RMS standard deviation (m), fraction touched."""

    error_m: float
    sd_m: float
    touched: float


class SettlingComparison(AnyComparison):
    """Settled with the first valid estimate; subclasses define what is compared and on which topics.

    `_shape` and `_body` are the last estimated shape and the true one, set by subclasses.
    """

    shape: ClassVar[str]
    """Name of the shape, and in `normals` of the directions in which it is touched."""
    normals: ClassVar[str]

    def __init__(self, seed: int, rig: str) -> None:
        super().__init__(seed, rig)
        self._t_settled: float | None = None
        self._estimate: Mapping[str, Any] = {}
        self._truth: Mapping[str, Any] = {}
        self._body: Mapping[str, Any] | None = None
        self._shape: Mapping[str, Any] | None = None
        self._mu = (math.nan, math.nan)  # last estimate and its standard deviation
        self._ticks = self._valid = 0
        self._losses = ObjectLosses()

    @property
    def settled(self) -> bool:
        """According to the published estimates."""
        return self._t_settled is not None

    def _take_estimate(self, fields: Mapping[str, Any]) -> None:
        self._ticks += 1
        self._estimate = fields
        self._losses.take(fields["mono_ns"] * 1e-9, fields["valid"], fields.get("object", 0))
        if math.isfinite(fields["mu"]):
            self._mu = fields["mu"], fields["sd"]["mu"]
        if not fields["valid"] or self.t_started is None:
            return
        self._valid += 1
        t = fields["mono_ns"] * 1e-9
        if self._t_settled is None:
            self._t_settled = t
        if self._truth and abs(self._truth["mono_ns"] * 1e-9 - t) < NEAR_S:
            self._compare(fields, self._truth)

    @abstractmethod
    def _compare(self, estimate: Mapping[str, Any], truth: Mapping[str, Any]) -> None:
        """Compare a valid estimate with the truth of the same moment."""

    @abstractmethod
    def _outline(self) -> OutlineFigures | None:
        """Errors of the shape, None before there is one."""

    @abstractmethod
    def _errors(self) -> list[str]:
        """Results of the comparisons."""

    def _progress(self) -> list[str]:
        """The exploration's reason, the estimate or why there is none, and serious faults."""
        estimate, figures = self._estimate, self._outline()
        parts = []
        if self._state.get("exploring") and self._state.get("reason"):
            parts.append(f"exploring: {self._state['reason']}")
        if not estimate.get("valid"):
            parts.append(f"no valid estimate: {estimate.get('reason') or 'no message received'}")
        elif figures is None:
            parts.append("valid estimate")
        else:
            parts.append(f"{self.shape} ± {figures.sd_m * 1e6:.0f} µm (1σ) on {figures.touched:.0%}")
            parts.append(f"[true error: {figures.error_m * 1e6:.0f} µm RMS]")
        return parts + self._serious_faults()

    def summary(self) -> str:
        """The final line."""
        if self._t_settled is None or self.t_started is None:
            settled = f"never settled: {self._estimate.get('reason', 'no message received')}"
        else:
            settled = f"settled after {self._t_settled - self.t_started:.1f} s"
        losses = filter(None, [self._losses.summary()])
        parts = [f"seed {self._seed}", f"rig {self._rig}", settled, *losses]
        if (figures := self._outline()) is not None:
            error, sd = (f"{each * 1e6:.0f} µm" for each in figures[:2])
            parts.append(f"{self.shape} {error} RMS on {figures.touched:.0%} touched {self.normals} (sd {sd})")
        parts += self._errors()
        if self._body is not None and math.isfinite(self._mu[0]):
            parts.append(f"mu {self._mu[0]:.3f} ± {self._mu[1]:.3f} (true {self._body['mu']:.3f})")
        parts += [f"ticks {self._ticks}, valid {self._valid}", self._work()]
        return "palmd demo: " + ", ".join(parts)
