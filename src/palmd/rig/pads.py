"""Emulated touchpads: when they report, and what they make of a contact. Pure.

Every pad needs a closing force, and its pressure drifts and lags. One that counts merges several contacts into one
weighted point and reports it in whole counts. A kind `K` is `palmd/rig/padkinds/K.py`, which says `EMULATOR`.
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
ACROSS_JITTER_COUNTS = 3  # noise across, evenly spread to both sides
LiftReport = Literal["flag", "silence"]


@dataclass(frozen=True, slots=True)
class PadOptions:
    """How good the pad is (m, N, s); `lift_report`: one packet with A = 0 on lift-off, or nothing at all."""

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
    """Something that presses on the pad: s (m) from the hinge, force (N), across (m) from the pad's middle line."""

    s: float
    force: float
    across: float = 0.0


class PadEmulator(ABC):
    """One pad of any kind. Ask `due` when it reports next and `report` what it then sends."""

    baud: int | None
    """Of its line; None where it is on none."""

    def __init__(
        self,
        config: PadBase,
        options: PadOptions,
        reading_error_m: Callable[[float, float], float],
        rng: np.random.Generator,
        t: float,
        *,
        shortest_s: float,
        noise_m: float,
    ) -> None:
        """`reading_error_m`: by distance (m) and force (N); the pad's clock starts soon after t (s).

        shortest_s: between reports.
        """
        self.packets = 0
        self._base, self._options, self._reading_error_m, self._rng = config, options, reading_error_m, rng
        self._shortest_s, self._noise_m = shortest_s, noise_m
        self._t_last = t
        self._touched = False
        self._drift = float(rng.normal(0.0, options.force_drift))
        self._felt = 0.0
        self.due = t + float(rng.uniform(0.0, 0.01))

    def report(self, t: float, presses: list[Press]) -> bytes:
        """What is said at t (s) of what presses on the pad then; empty if the pad is silent."""
        self._drift_to(t)
        self.due = max(self.due + self._interval(), t + self._shortest_s)
        felt = [press for press in presses if self._feels(press)]
        if not felt:
            lifted, self._touched, self._felt = self._touched, False, 0.0
            said = self._untouched(t, lifted)
        else:
            self._touched = True
            said = self._pressed(t, felt)
        self.packets += bool(said)
        return said

    def hear(self, data: bytes, t: float) -> None:  # noqa: B027
        """The host has written this by `t` (s); most pads listen to nothing."""

    def greeting(self) -> list[tuple[bytes, float]]:
        """What it says when its port is opened, and how many seconds after that."""
        return []

    def overflow(self, t: float) -> bytes:  # noqa: ARG002
        """What comes instead when the kernel has dropped reports by t (s); a serial line's are dropped unsaid."""
        return b""

    @abstractmethod
    def listener(self) -> Decoder:
        """A new decoder of what it says."""

    @abstractmethod
    def _interval(self) -> float:
        """Until the next report (s)."""

    @abstractmethod
    def _pressed(self, t: float, felt: list[Press]) -> bytes:
        """What is said of what presses on the pad hard enough."""

    @abstractmethod
    def _untouched(self, t: float, lifted: bool) -> bytes:
        """What is said of none; `lifted` says that there was one."""

    def _feels(self, press: Press) -> bool:
        on_pad = 0.0 < press.s < self._base.length_mm * 1e-3 and abs(press.across) < 0.5 * WIDTH_M
        return on_pad and press.force > self._options.dead_band_n

    def _seen_m(self, s: float, force: float) -> float:
        """Where a contact at `s` (m) under a force (N) appears to be, noise included (m)."""
        return s + self._reading_error_m(s, force) + float(self._rng.normal(0.0, self._noise_m))

    def _felt_n(self, force: float) -> float:
        """What is felt of a force (N), with hysteresis, drift and noise."""
        options = self._options
        slack = options.hysteresis * force
        self._felt = min(max(self._felt, force - slack), force + slack)
        return self._felt * (1.0 + self._drift + float(self._rng.normal(0.0, options.force_noise)))

    def _drift_to(self, t: float) -> None:
        """An Ornstein–Uhlenbeck walk of the gain."""
        options = self._options
        keep = math.exp(-(t - self._t_last) / options.force_drift_s)
        kick = options.force_drift * math.sqrt(1.0 - keep * keep)
        self._drift = keep * self._drift + float(self._rng.normal(0.0, kick))
        self._t_last = t


class CountingPad(PadEmulator):
    """A pad that merges its contacts into one point and reports that in counts."""

    def __init__(
        self,
        config: PadBase,
        options: PadOptions,
        reading_error_m: Callable[[float, float], float],
        rng: np.random.Generator,
        t: float,
        *,
        counts: tuple[int, int],
        full_scale: int,
        shortest_s: float,
        noise_m: float,
    ) -> None:
        """See `PadEmulator`. counts: the least and the largest position; full_scale: the largest pressure."""
        self._range, self._full_scale = counts, full_scale
        super().__init__(config, options, reading_error_m, rng, t, shortest_s=shortest_s, noise_m=noise_m)

    @abstractmethod
    def _touch(self, t: float, counts: int, across: int, pressure: int) -> bytes:
        """What is said of a touch, counts along and across the palm."""

    def _pressed(self, t: float, felt: list[Press]) -> bytes:
        total = sum(press.force for press in felt)
        counts = self._counts(sum(press.s * press.force for press in felt) / total, total)
        across = self._counts_across(sum(press.across * press.force for press in felt) / total)
        return self._touch(t, counts, across, self._pressure(total))

    def _counts(self, s: float, force: float) -> int:
        config = self._base
        counts = round(config.sign * (self._seen_m(s, force) * 1e3 - config.zero_mm) * config.counts_per_mm)
        return min(max(counts, self._range[0]), self._range[1])

    def _counts_across(self, across: float) -> int:
        jitter = int(self._rng.integers(-ACROSS_JITTER_COUNTS, ACROSS_JITTER_COUNTS + 1))
        return min(max(round(across * 1e3 * self._base.counts_per_mm) + jitter, self._range[0]), self._range[1])

    def _pressure(self, force: float) -> int:
        counts = round(self._felt_n(force) / self._base.newtons_per_count)
        return min(max(counts, 1), self._full_scale)


EmulatorFactory = Callable[..., PadEmulator]
"""Takes its kind's configuration, options, the reading's error, random numbers and the time; see `PadEmulator`."""


def make_emulator(
    config: PadConfig,
    options: PadOptions,
    reading_error_m: Callable[[float, float], float],
    rng: np.random.Generator,
    t: float,
) -> PadEmulator:
    """The emulated far side of a configured pad."""
    emulator: EmulatorFactory = importlib.import_module(f"palmd.rig.padkinds.{config.kind}").EMULATOR
    return emulator(config, options, reading_error_m, rng, t)
