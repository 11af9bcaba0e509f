"""What comparisons have in common where the daemon itself tells whether its estimate is valid, and why not. Pure."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from palmd.harness.comparison import AnyComparison
from palmd.harness.standing import Standing

NEAR_S = 6e-3  # between an estimate and the truth that it is held against


class OutlineFigures(NamedTuple):
    """Of the estimated shape where it was touched: RMS error (m), RMS of the 1σ (m), and the share touched."""

    off_m: float
    sd_m: float
    touched: float


class SettlingComparison(AnyComparison):
    """Settled with the first estimate that is called valid; a derived one says what is compared, and of which topics.

    `_shape` and `_body` are the last estimated shape and the true one, for a derived one to keep.
    """

    shape: ClassVar[str]
    """What the shape is called, and `normals`, what it is touched at."""
    normals: ClassVar[str]

    def __init__(self, seed: int, rig: str) -> None:
        super().__init__(seed, rig)
        self._t_settled: float | None = None
        self._estimate: Mapping[str, Any] = {}
        self._truth: Mapping[str, Any] = {}
        self._body: Mapping[str, Any] | None = None
        self._shape: Mapping[str, Any] | None = None
        self._mu = (math.nan, math.nan)  # the last one told, with its band
        self._ticks = self._valid = 0
        self._standing = Standing()

    @property
    def settled(self) -> bool:
        """By what is published."""
        return self._t_settled is not None

    def _take_estimate(self, fields: Mapping[str, Any]) -> None:
        self._ticks += 1
        self._estimate = fields
        self._standing.take(fields["mono_ns"] * 1e-9, fields["valid"], fields.get("object", 0))
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
        """A valid estimate and the truth of the same moment."""

    @abstractmethod
    def _outline(self) -> OutlineFigures | None:
        """How far the shape is off, once there is one."""

    @abstractmethod
    def _errors(self) -> list[str]:
        """What came of the moments compared."""

    def _progress(self) -> list[str]:
        """What the exploration does, what is estimated or why not, and grave faults."""
        estimate, figures = self._estimate, self._outline()
        parts = []
        if self._state.get("exploring") and self._state.get("reason"):
            parts.append(f"exploring: {self._state['reason']}")
        if not estimate.get("valid"):
            parts.append(f"no valid estimate: {estimate.get('reason') or 'nothing is heard'}")
        elif figures is None:
            parts.append("valid estimate")
        else:
            parts.append(f"{self.shape} ± {figures.sd_m * 1e6:.0f} µm (1σ) on {figures.touched:.0%}")
            parts.append(f"[truth: {figures.off_m * 1e6:.0f} µm RMS off]")
        return parts + self._grave()

    def summary(self) -> str:
        """The closing line."""
        if self._t_settled is None or self.t_started is None:
            settled = f"never settled: {self._estimate.get('reason', 'nothing is heard')}"
        else:
            settled = f"settled after {self._t_settled - self.t_started:.1f} s"
        standing = filter(None, [self._standing.words()])
        parts = [f"seed {self._seed}", f"rig {self._rig}", settled, *standing]
        if (figures := self._outline()) is not None:
            off, sd = (f"{each * 1e6:.0f} µm" for each in figures[:2])
            parts.append(f"{self.shape} {off} RMS on {figures.touched:.0%} touched {self.normals} (sd {sd})")
        parts += self._errors()
        if self._body is not None and math.isfinite(self._mu[0]):
            parts.append(f"mu {self._mu[0]:.3f} ± {self._mu[1]:.3f} (true {self._body['mu']:.3f})")
        parts += [f"ticks {self._ticks}, valid {self._valid}", self._work()]
        return "palmd demo: " + ", ".join(parts)
