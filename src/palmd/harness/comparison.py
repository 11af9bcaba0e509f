"""What a daemon estimates against what its emulated rig knows to be true. Pure: messages in, words out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.bus.subscriber import Message
from palmd.score import OutlineScore, score_outline

WINDOW_TICKS = 500  # the last five seconds
TRUTHS = 100
GRID_TICKS = 100
LATE_S = 2e-3
PERIOD_S = 0.01
_COMPARED = ("r1_m", "r2_m", "omega0_rad_s")


class Comparison:
    """Takes the messages of both as they come; needs the same memory however long it runs."""

    def __init__(self, seed: int) -> None:
        """`seed` is the rig's, to be named in the summary."""
        self.state: Mapping[str, Any] = {}
        self.motion: Mapping[str, Any] = {}
        self.t_started: float | None = None
        self._seed = seed
        self._t_settled: float | None = None
        self._estimate: Mapping[str, Any] = {}
        self._valid: Mapping[str, Any] = {}  # the last valid estimate
        self._shape: Mapping[str, Any] | None = None
        self._object: Mapping[str, Any] | None = None
        self._truths: deque[tuple[float, ...]] = deque(maxlen=TRUTHS)
        self._waiting: deque[tuple[float, ...]] = deque(maxlen=TRUTHS)  # valid ticks whose truth is to come
        self._errors: deque[tuple[float, ...]] = deque(maxlen=WINDOW_TICKS)
        self._punctuality = Punctuality()
        self._ticks = 0
        self._work_p99_ms: deque[float] = deque(maxlen=WINDOW_TICKS)  # one a second

    @property
    def settled(self) -> bool:
        """Whether an estimate has been called valid since the palms began to move."""
        return self._t_settled is not None

    def started(self, t: float) -> None:
        """The palms begin to move at t (s, monotonic clock), for the first time or again."""
        if self.t_started is None:
            self.t_started = t

    def take(self, message: Message) -> None:
        """One message of the daemon or of the rig."""
        fields = message.fields
        match message.topic:
            case "palm/estimate":
                self._take_estimate(fields)
            case "palm/shape" if self._estimate.get("valid"):
                self._shape = fields
            case "palm/state":
                self.state = fields
            case "palm/motion":
                self.motion = fields
            case "palm/loop":
                self._work_p99_ms.append(fields["work_p99_ms"])
            case "rig/truth":
                self._truths.append((_seconds(fields), *(fields[name] for name in _COMPARED)))
                self._compare()
            case "rig/object":
                self._object = fields

    def _take_estimate(self, fields: Mapping[str, Any]) -> None:
        t = _seconds(fields)
        self._estimate = fields
        self._ticks += 1
        self._punctuality.tick(t)
        if fields["valid"] and self.t_started is not None and t >= self.t_started:
            if self._t_settled is None:
                self._t_settled = t
            self._valid = fields
            self._waiting.append((t, *(fields[name] for name in _COMPARED)))

    def _compare(self) -> None:
        """Compare the ticks that now lie between two truths, by interpolation."""
        known = np.array(self._truths)
        while self._waiting and self._waiting[0][0] <= known[-1, 0]:
            t, *estimated = self._waiting.popleft()
            if t >= known[0, 0]:
                true = [float(np.interp(t, known[:, 0], column)) for column in known.T[1:]]
                self._errors.append(tuple(a - b for a, b in zip(estimated, true, strict=True)))

    def progress(self, t: float) -> str:
        """One line on how it stands at t (s, monotonic clock)."""
        parts = [f"{t - (self.t_started or t):5.0f} s  {self.state.get('state', ''):8}"]
        if self._estimate.get("valid"):
            e = self._estimate
            parts.append(f"r {e['r1_m'] * 1e3:.2f} {e['r2_m'] * 1e3:.2f} mm")
            parts.append(f"rho {e['rho_m'] * 1e3:.2f} mm  mu {e['mu']:z.2f}  mass {e['mass_kg'] * 1e3:.0f} g")
            score = self._score()
            if score is not None:
                parts.append(f"outline within {score.e_h * 1e6:.0f} µm on {score.touched:.0%}")
        else:
            parts.append("lost, looking again" if self.settled else "no valid estimate yet")
        faults = self.state.get("faults", ())
        grave = [f for f, severity in zip(faults, self.state.get("severities", ()), strict=False) if severity != "note"]
        return "  ".join(parts + grave)

    def summary(self) -> str:
        """The closing line."""
        parts = [f"seed {self._seed}", self._settling()]
        score = self._score()
        if score is not None and self._shape is not None and self._object is not None:
            parts.append(
                f"outline {score.e_h * 1e6:.0f} µm RMS ({score.relative:.2%}) on {score.touched:.0%} touched normals"
            )
            everywhere = np.ones(len(self._shape["theta_rad"]), dtype=np.bool_)
            off, sd = _scored(self._shape, self._object, everywhere).max_error, max(self._shape["h_sd_m"])
            parts.append(f"whole outline within {off * 1e3:.3f} mm (largest sd {sd * 1e3:.3f} mm)")
        if self._errors:
            r1, r2, omega0 = np.sqrt(np.mean(np.square(self._errors), axis=0))
            parts += [f"r {math.hypot(r1, r2) / math.sqrt(2) * 1e3:.3f} mm", f"omega0 {omega0:.3f} rad/s"]
        if self._valid and self._object:
            mine, true = self._valid, self._object
            parts += [
                f"rho {mine['rho_m'] / true['rho_m'] - 1:+.1%}",
                f"mu {mine['mu']:z.2f} (true {true['mu']:.2f})",
                f"mass {mine['mass_kg'] / true['mass_kg'] - 1:+.1%}",
            ]
        parts += [
            f"ticks {self._ticks}",
            f"late > {LATE_S * 1e3:g} ms {self._punctuality.late_share(self._ticks):.2%}",
            f"work p99 {float(np.median(self._work_p99_ms or [math.nan])):.1f} ms",
        ]
        return "palmd demo: " + ", ".join(parts)

    def _settling(self) -> str:
        name = self._estimate.get("observer", "")
        if self._t_settled is None or self.t_started is None:
            return f"{name} observer never settled"
        return f"{name} observer settled after {self._t_settled - self.t_started:.1f} s"

    def _score(self) -> OutlineScore | None:
        """The outline against the true one where it was touched; None before there are both."""
        if self._shape is None or self._object is None or not any(self._shape["touched"]):
            return None
        return _scored(self._shape, self._object, np.array(self._shape["touched"], dtype=np.bool_))


def _scored(shape: Mapping[str, Any], true: Mapping[str, Any], where: npt.NDArray[np.bool_]) -> OutlineScore:
    theta, h, true_h = (
        np.array(values, dtype=np.float64) for values in (shape["theta_rad"], shape["h_m"], true["h_m"])
    )
    return score_outline(theta, h, where, true_h)


class Punctuality:
    """How many ticks began late or not at all, judged from their times alone: the grid is where most of them are."""

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
        """The share of ticks later than `LATE_S`, given how many there were; NaN before `GRID_TICKS` of them."""
        if math.isnan(self._grid):
            return math.nan
        due = round((self._latest - self._first[0]) / PERIOD_S) + 1
        return (self._late + max(0, due - ticks)) / due

    def _is_late(self, t: float) -> bool:
        return LATE_S < (t - self._grid) % PERIOD_S < PERIOD_S - LATE_S / 2


def _seconds(fields: Mapping[str, Any]) -> float:
    return float(fields["mono_ns"] * 1e-9)
