"""Emulated touchpads: when they report, and what they report of a contact. Pure.

Every pad has a threshold force, and its pressure drifts and has hysteresis. A counting pad merges several contacts into
one weighted point and reports it in whole counts. A kind `K` is implemented in `palmd/rig/padkinds/K.py`, which defines
`EMULATOR`.
"""

from __future__ import annotations

import importlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palmd.config.pads import PadBase, PadConfig
from palmd.rig.tally import Decoder

WIDTH_M = 0.0395
ACROSS_JITTER_COUNTS = 3  # noise across the palm, uniform to both sides
LiftReport = Literal["flag", "silence"]


@dataclass(frozen=True, slots=True)
class PadOptions:
    """Quality of a pad (m, N, s); `lift_report`: one packet with A = 0 on lift-off, or nothing."""

    noise_m: float = 1e-4
    force_noise: float = 0.04
    force_drift: float = 0.03
    force_drift_s: float = 20.0
    hysteresis: float = 0.02
    dead_band_n: float = 0.04
    lift_report: LiftReport = "flag"


GOOD_PADS = PadOptions()


@dataclass(frozen=True, slots=True)
class Press:
    """A contact on the pad: s (m) from the hinge, force (N), across (m) from the pad's middle line."""

    s: float
    force: float
    across: float = 0.0


class PadEmulator(ABC):
    """One pad of any kind. `due` is the time of the next report, `report` returns what is then sent."""

    _config: PadBase

    def __init__(
        self,
        config: PadBase,
        options: PadOptions,
        reading_error_m: Callable[[float, float], float],
        rng: np.random.Generator,
        t: float,
    ) -> None:
        """`reading_error_m`: position error (m) by distance (m) and force (N); the clock starts soon after t (s)."""
        self.packets = 0
        self._config, self._options, self._reading_error_m, self._rng = config, options, reading_error_m, rng
        self._t_last = t
        self._was_touched = False
        self._drift = float(rng.normal(0.0, options.force_drift))
        self._lagging_force = 0.0
        self.due = t + float(rng.uniform(0.0, 0.01))
        self._begin(t)

    @property
    @abstractmethod
    def baud(self) -> int | None:
        """Baud rate of its line; None if it has none."""

    def report(self, t: float, presses: list[Press]) -> bytes:
        """The bytes sent at t (s) for these contacts; empty if the pad sends nothing."""
        self._drift_to(t)
        self.due = max(self.due + self._interval(), t + self._min_interval())
        contacts = [press for press in presses if self._is_detected(press)]
        if not contacts:
            was_lifted, self._was_touched, self._lagging_force = self._was_touched, False, 0.0
            data = self._lifted_report(t, was_lifted)
        else:
            self._was_touched = True
            data = self._contact_report(t, contacts)
        self.packets += bool(data)
        return data

    def receive(self, data: bytes, t: float) -> None:  # noqa: B027
        """Receive what the host wrote by `t` (s); most pads ignore it."""

    def greeting(self) -> list[tuple[bytes, float]]:
        """What it sends when its port is opened, each with the delay (s)."""
        return []

    def overflow(self, t: float) -> bytes:  # noqa: ARG002
        """What is sent when the kernel has dropped reports by t (s); a serial line drops them silently."""
        return b""

    @abstractmethod
    def make_decoder(self) -> Decoder:
        """A new decoder of what the pad sends."""

    def _begin(self, t: float) -> None:  # noqa: B027
        """Initialise what only this kind has, at t (s)."""

    _report_s: float
    _jitter_s: float
    """Mean and standard deviation of the time between reports, of a pad that reports at a constant rate."""

    def _interval(self) -> float:
        """Time until the next report (s)."""
        return self._report_s + float(self._rng.normal(0.0, self._jitter_s))

    def _min_interval(self) -> float:
        """Shortest time between reports (s)."""
        return self._report_s - 5 * self._jitter_s

    @property
    def _noise_m(self) -> float:
        """Standard deviation of a position (m)."""
        return self._config.noise_mm * 1e-3

    @abstractmethod
    def _contact_report(self, t: float, contacts: list[Press]) -> bytes:
        """The report of contacts that exceed the threshold."""

    @abstractmethod
    def _lifted_report(self, t: float, lifted: bool) -> bytes:
        """The report without contacts; `lifted` if there was one at the previous report."""

    def _is_detected(self, press: Press) -> bool:
        on_pad = 0.0 < press.s < self._config.length_mm * 1e-3 and abs(press.across) < 0.5 * WIDTH_M
        return on_pad and press.force > self._options.dead_band_n

    def _measured_position_m(self, s: float, force: float) -> float:
        """The measured position (m) of a contact at `s` (m) under a force (N), noise included."""
        return s + self._reading_error_m(s, force) + float(self._rng.normal(0.0, self._noise_m))

    def _measured_force_n(self, force: float) -> float:
        """The measured force (N), with hysteresis, drift and noise."""
        options = self._options
        half_width = options.hysteresis * force
        self._lagging_force = min(max(self._lagging_force, force - half_width), force + half_width)
        return self._lagging_force * (1.0 + self._drift + float(self._rng.normal(0.0, options.force_noise)))

    def _drift_to(self, t: float) -> None:
        """Advance the gain's drift, an Ornstein–Uhlenbeck process, to t (s)."""
        options = self._options
        keep = math.exp(-(t - self._t_last) / options.force_drift_s)
        step_sd = options.force_drift * math.sqrt(1.0 - keep * keep)
        self._drift = keep * self._drift + float(self._rng.normal(0.0, step_sd))
        self._t_last = t


class CountingPad(PadEmulator):
    """A pad that merges its contacts into one point and reports it in counts."""

    _range: tuple[int, int]
    """Smallest and largest position (counts)."""
    _full_scale: int
    """Largest pressure (counts)."""

    @abstractmethod
    def _touch_report(self, t: float, counts: int, across: int, pressure: int) -> bytes:
        """The report of a touch, in counts along and across the palm."""

    def _contact_report(self, t: float, contacts: list[Press]) -> bytes:
        total = sum(press.force for press in contacts)
        counts = self._counts(sum(press.s * press.force for press in contacts) / total, total)
        across = self._counts_across(sum(press.across * press.force for press in contacts) / total)
        return self._touch_report(t, counts, across, self._pressure(total))

    def _counts(self, s: float, force: float) -> int:
        config = self._config
        counts = round(
            config.sign * (self._measured_position_m(s, force) * 1e3 - config.zero_mm) * config.counts_per_mm
        )
        return min(max(counts, self._range[0]), self._range[1])

    def _counts_across(self, across: float) -> int:
        jitter = int(self._rng.integers(-ACROSS_JITTER_COUNTS, ACROSS_JITTER_COUNTS + 1))
        return min(max(round(across * 1e3 * self._config.counts_per_mm) + jitter, self._range[0]), self._range[1])

    def _pressure(self, force: float) -> int:
        counts = round(self._measured_force_n(force) / self._config.newtons_per_count)
        return min(max(counts, 1), self._full_scale)


EmulatorFactory = Callable[..., PadEmulator]
"""Takes the kind's configuration, options, the reading error, random numbers and the time; see `PadEmulator`."""


def make_emulator(
    config: PadConfig,
    options: PadOptions,
    reading_error_m: Callable[[float, float], float],
    rng: np.random.Generator,
    t: float,
) -> PadEmulator:
    """The emulator of a configured pad."""
    emulator: EmulatorFactory = importlib.import_module(f"palmd.rig.padkinds.{config.kind}").EMULATOR
    return emulator(config, options, reading_error_m, rng, t)
