"""Comparison of a daemon's estimates with the truth of its emulated rig. Pure: messages in, text out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from palmd.bus.subscriber import Message
from palmd.daemon.journal import LOST_S
from palmd.harness.scorer import COMPARED, Scorer
from palmd.score import OutlineScore
from palmd.system.mechanism import RADII

LOOPS = 300  # messages of palm/loop kept, one per second
TRUTHS = 100
GRID_TICKS = 100
LATE_S = 2e-3
REPEAT_S = 10.0
"""Time after which an unchanged progress line is repeated (convention)."""
PERIOD_S = 0.01
NEAR_S = 6e-3  # largest time difference of an estimate and the truth that it is compared with
_TIMES = {0: "never", 1: "once", 2: "twice"}
_RADII = tuple(f"{name}_m" for name in RADII)


class AnyComparison(ABC):
    """Processes the messages of daemon and rig, for any system; memory does not grow with the duration."""

    explored: ClassVar[str]
    """Name of what explorations cover."""

    def __init__(self, seed: int, rig: str) -> None:
        """The rig's `seed`, and a description of its imperfections, for the summary."""
        self._seed, self._rig = seed, rig
        self.t_started: float | None = None
        self._state: Mapping[str, Any] = {}
        self._estimate: Mapping[str, Any] = {}
        self._body: Mapping[str, Any] | None = None
        """The true object, set by subclasses."""
        self._ticks = 0
        self._losses = ObjectLosses()
        self._work_p99_ms: deque[float] = deque(maxlen=LOOPS)
        self._last_progress, self._t_shown = "", -math.inf

    @property
    @abstractmethod
    def settled(self) -> bool:
        """Whether an estimate has been valid since the rig began to move."""

    def started(self, t: float) -> None:
        """The rig begins to move at t (s, monotonic clock), for the first time or again."""
        if self.t_started is None:
            self.t_started = t

    def take(self, message: Message) -> None:
        """Process a message of the daemon or the rig."""
        match message.topic:
            case "palm/state":
                self._state = message.fields
            case "palm/loop":
                self._work_p99_ms.append(message.fields["work_p99_ms"])
            case topic:
                self._take(topic, message.fields)

    @abstractmethod
    def _take(self, topic: str, fields: Mapping[str, Any]) -> None:
        """Process a message of one of the system's own topics."""

    def _count(self, fields: Mapping[str, Any]) -> float:
        """Process what estimates of all systems have in common; return the time (s)."""
        t = _seconds(fields)
        self._ticks += 1
        self._estimate = fields
        self._losses.take(t, fields["valid"], fields.get("object", 0))
        return t

    def progress(self, t: float) -> str:
        """One line of progress at t (s, monotonic clock); empty if unchanged for less than `REPEAT_S`."""
        parts = [f"{self._state.get('state', ''):8}", *self._progress()]
        words = "  ".join(parts)
        if words == self._last_progress and t < self._t_shown + REPEAT_S:
            return ""
        self._last_progress, self._t_shown = words, t
        return f"{t - (self.t_started or t):5.0f} s  {words}"

    @abstractmethod
    def _progress(self) -> list[str]:
        """The parts of the progress line except the daemon's state."""

    @abstractmethod
    def summary(self) -> str:
        """The final line."""

    def _share(self) -> str:
        """The share explored, such as " 50% of all directions"; empty while unknown."""
        coverage = self._state.get("coverage", math.nan)
        return f" {coverage:.0%} of {self.explored}" if math.isfinite(coverage) else ""

    def _exploring(self) -> list[str]:
        """What an exploration under way has covered, and its reason for what the rig does."""
        if not self._state.get("exploring"):
            return []
        return [": ".join(filter(None, (f"exploring{self._share()}", self._state.get("reason"))))]

    def _serious_faults(self) -> list[str]:
        """Codes of the faults that are more than a note."""
        faults = zip(self._state.get("faults", ()), self._state.get("severities", ()), strict=False)
        return [fault for fault, severity in faults if severity != "note"]

    def _work(self) -> str:
        return f"work p99 {float(np.median(self._work_p99_ms or [math.nan])):.1f} ms"


class Comparison(AnyComparison):
    """Comparison for two palms."""

    explored = "what can be reached"

    def __init__(self, seed: int, rig: str) -> None:
        super().__init__(seed, rig)
        self._scorer = Scorer()
        self._truths: deque[tuple[float, ...]] = deque(maxlen=TRUTHS)
        self._waiting: deque[tuple[float, ...]] = deque(maxlen=TRUTHS)  # valid ticks whose truth has not arrived
        self._punctuality = Punctuality()
        self._stalled: list[float] = []  # duration (s) of each stall of the emulated rig since the last progress line
        self._stalls, self._stalled_s = 0, 0.0

    @property
    def settled(self) -> bool:
        """According to the scorer."""
        return self._scorer.t_settled is not None

    def started(self, t: float) -> None:
        """Start the scorer's clock as well."""
        super().started(t)
        self._scorer.t_started = self.t_started

    def _take(self, topic: str, fields: Mapping[str, Any]) -> None:
        match topic:
            case "palm/estimate":
                self._take_estimate(fields)
            case "palm/shape":
                self._scorer.take_shape(fields)
            case "rig/truth":
                self._truths.append((_seconds(fields), *(fields[name] for name in COMPARED)))
                self._compare()
            case "rig/object":
                self._body = fields
            case "rig/stall":
                self._stalled.append(fields["lasted_s"])
                self._stalls += 1
                self._stalled_s += fields["lasted_s"]

    def _take_estimate(self, fields: Mapping[str, Any]) -> None:
        t = self._count(fields)
        self._punctuality.tick(t)
        if self._scorer.take(t, fields):
            self._waiting.append((t, *(fields[name] for name in COMPARED)))

    def _compare(self) -> None:
        """Compare the ticks that now lie between two truth messages, by interpolation."""
        truths = np.array(self._truths)
        while self._waiting and self._waiting[0][0] <= truths[-1, 0]:
            t, *estimated = self._waiting.popleft()
            if t >= truths[0, 0]:
                self._scorer.compare(
                    t, estimated, [float(np.interp(t, truths[:, 0], column)) for column in truths.T[1:]]
                )

    def _progress(self) -> list[str]:
        """The exploration's reason, the estimate or why there is none, and serious faults."""
        parts = self._exploring()
        e = self._estimate
        if e.get("valid"):
            radii = " ".join(f"{e[name] * 1e3:.2f}" for name in _RADII)
            parts.append(f"r {radii} mm")
            parts.append(f"rho {e['rho_m'] * 1e3:.2f} mm  mu {e['mu']:z.2f}  mass {e['mass_kg'] * 1e3:.0f} g")
            score = self._score()
            if score is not None:
                parts.append(f"outline ± {self._band() * 1e6:.0f} µm (1σ) on {score.touched:.0%}")
                parts.append(f"[true error: {score.e_h * 1e6:.0f} µm RMS]")
        else:
            reasons = ", ".join(e.get("invalid_reasons", ()))
            parts.append(
                ("lost, re-initialising" if self.settled else "no valid estimate yet") + (reasons and f" ({reasons})")
            )
        remarks = self._serious_faults()
        if self._stalled:
            remarks.append(f"(the emulated rig got no processor time for {max(self._stalled) * 1e3:.0f} ms)")
            self._stalled.clear()
        return parts + remarks

    def summary(self) -> str:
        """The final line."""
        settling = f"settled after {self._scorer.settling_s:.1f} s" if self.settled else "never settled"
        observer = f"{self._estimate.get('observer', '')} observer {settling}"
        parts = [f"seed {self._seed}", observer, *filter(None, [self._losses.summary()])]
        score, everywhere = self._score(), self._score(all_normals=True)
        if score is not None and everywhere is not None and self._scorer.shape is not None:
            sd, band = np.array(self._scorer.shape["h_sd_m"]), self._band()
            parts += [
                f"outline {score.e_h * 1e6:.0f} µm RMS ({score.relative:.2%}) on {score.touched:.0%} touched normals"
                f" (sd {band * 1e6:.0f} µm)",
                f"whole outline within {everywhere.max_error * 1e3:.3f} mm (largest sd {sd.max() * 1e3:.3f} mm)",
            ]
        r, omega0 = self._scorer.rms()
        if not math.isnan(r):
            parts += [f"r {r * 1e3:.3f} mm", f"omega0 {omega0:.3f} rad/s"]
        if self.settled and self._body:
            rho, mu, mass = self._scorer.constants(self._body)
            true_mu = self._body["mu"]
            parts += [f"rho {rho:+.1%}", f"mu {mu + true_mu:z.2f} (true {true_mu:.2f})", f"mass {mass:+.1%}"]
        parts += [
            f"ticks {self._ticks}",
            f"late > {LATE_S * 1e3:g} ms {self._punctuality.late_share(self._ticks):.2%}",
            self._work(),
            f"rig {self._rig}",
        ]
        if self._stalls:
            parts.append(f"which got no processor time {self._stalls} times, {self._stalled_s:.2f} s in total")
        return "palmd demo: " + ", ".join(parts)

    def _band(self) -> float:
        """RMS of the last valid outline's standard deviation on touched normals (m)."""
        shape = self._scorer.shape or {}
        sd, touched = (np.array(shape[name]) for name in ("h_sd_m", "touched"))
        return math.sqrt(np.mean(sd[touched > 0] ** 2))

    def _score(self, *, all_normals: bool = False) -> OutlineScore | None:
        """The outline compared with the true one, on touched or all normals; None before both are available."""
        return None if self._body is None else self._scorer.outline(self._body["h_m"], all_normals=all_normals)


class Punctuality:
    """Counts ticks that began late or were skipped, judged by their times only; most of them define the grid."""

    def __init__(self) -> None:
        self._first: list[float] = []
        self._grid = self._latest = math.nan
        self._late = 0

    def tick(self, t: float) -> None:
        """A tick began at t (s)."""
        self._latest = t
        if not math.isnan(self._grid):
            self._late += self._is_late(t)
            return
        self._first.append(t)
        if len(self._first) == GRID_TICKS:
            offsets = [math.remainder(each - self._first[0], PERIOD_S) for each in self._first]
            self._grid = self._first[0] + float(np.median(offsets))
            self._late = sum(map(self._is_late, self._first))

    def late_share(self, ticks: int) -> float:
        """Fraction of ticks later than `LATE_S` or skipped, given their number; NaN before `GRID_TICKS` of them."""
        if math.isnan(self._grid):
            return math.nan
        due = round((self._latest - self._first[0]) / PERIOD_S) + 1
        return (self._late + max(0, due - ticks)) / due

    def _is_late(self, t: float) -> bool:
        return LATE_S < (t - self._grid) % PERIOD_S < PERIOD_S - LATE_S / 2


class OutlineFigures(NamedTuple):
    """Of the estimated shape on touched normals: RMS error (m), RMS standard deviation (m), fraction touched."""

    error_m: float
    sd_m: float
    touched: float


class SettlingComparison(AnyComparison):
    """Comparison of estimates that carry the daemon's own reason when they are invalid.

    Settled with the first valid estimate; subclasses define what is compared and on which topics, and set `_shape`, the
    last estimated one.
    """

    shape: ClassVar[str]
    """Name of the shape, and in `normals` of the directions in which it is touched."""
    normals: ClassVar[str]

    def __init__(self, seed: int, rig: str) -> None:
        super().__init__(seed, rig)
        self._t_settled: float | None = None
        self._truth: Mapping[str, Any] = {}
        self._shape: Mapping[str, Any] | None = None
        self._mu = (math.nan, math.nan)  # last estimate and its standard deviation
        self._valid = 0

    @property
    def settled(self) -> bool:
        """According to the published estimates."""
        return self._t_settled is not None

    def _take_estimate(self, fields: Mapping[str, Any]) -> None:
        t = self._count(fields)
        if math.isfinite(fields["mu"]):
            self._mu = fields["mu"], fields["sd"]["mu"]
        if not fields["valid"] or self.t_started is None:
            return
        self._valid += 1
        if self._t_settled is None:
            self._t_settled = t
        if self._truth and abs(_seconds(self._truth) - t) < NEAR_S:
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
        parts = self._exploring()
        if not estimate.get("valid"):
            parts.append(f"no valid estimate: {estimate.get('reason') or 'no message received'}")
        elif figures is None:
            parts.append("valid estimate")
        else:
            parts.append(f"{self.shape} ± {figures.sd_m * 1e6:.0f} µm (1σ) where touched ({figures.touched:.0%})")
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
        if share := self._share():
            parts.append(f"explored{share}")
        parts += self._errors()
        if self._body is not None and math.isfinite(self._mu[0]):
            parts.append(f"mu {self._mu[0]:.3f} ± {self._mu[1]:.3f} (true {self._body['mu']:.3f})")
        parts += [f"ticks {self._ticks}, valid {self._valid}", self._work()]
        return "palmd demo: " + ", ".join(parts)


class ObjectLosses:
    """Processes every estimate's time, validity and object number; memory does not grow with the duration.

    An object is lost if it had a valid estimate and then none for `LOST_S`, or if another one is started.
    """

    def __init__(self) -> None:
        self.losses = 0
        self._object = 0
        self._known = False
        self._t = self._t_valid = -math.inf

    def take(self, t: float, valid: bool, number: int) -> None:
        """Process an estimate at t (s)."""
        self._t = t
        if self._known and (number != self._object or (not valid and t - self._t_valid > LOST_S)):
            self.losses += 1
            self._known = False
        self._object = number
        if valid:
            self._known, self._t_valid = True, t

    @property
    def known(self) -> bool:
        """Whether the object has a valid estimate, or had one less than `LOST_S` ago."""
        return self._known

    def summary(self) -> str:
        """State at the last estimate, such as "object 2 valid at the end, lost once"; empty if none was valid."""
        if not math.isfinite(self._t_valid):
            return ""
        ago = self._t - self._t_valid
        last = "valid" if self._known else f"not valid (last valid {ago:.1f} s before)"
        return f"object {self._object} {last} at the end, lost {_TIMES.get(self.losses, f'{self.losses} times')}"


def _seconds(fields: Mapping[str, Any]) -> float:
    return float(fields["mono_ns"] * 1e-9)
