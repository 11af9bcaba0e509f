"""Emulated touchpads: when they report, and what they make of a contact. Pure.

A VersaPad is a four-wire resistive pad with pressure: it needs a closing force, its pressure drifts and lags, several
contacts merge into one weighted point, positions come in whole counts, and reports fall into three bands of
one, two and three packet times (mean 10 ms, s.d. near 5 ms) on the pad's own clock.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palmd.config.pads import PadBase, VersaPadConfig
from palmd.devices.versapad import (
    COUNT_MAX,
    COUNT_MIN,
    PACKET_BYTES,
    PressureFormat,
    VersaPadDecoder,
    encode_packet,
)
from palmd.rig.tally import Decoder

PACKET_S = 0.00625  # at 9600 baud; a faster line does not make the pad measure faster
BAND_WEIGHTS = (0.64, 0.20, 0.16)  # with the jitter cut off below one packet time, mean 10.0 and s.d. 4.7 ms
_BANDS_UP_TO: list[float] = np.cumsum(BAND_WEIGHTS).tolist()
BAND_JITTER_S = 0.002
WIDTH_M = 0.0395
ACROSS_JITTER_COUNTS = 3  # noise across, evenly spread to both sides
_IDENTITY = b"VPEMU1\r"
_IDENTITY_S = 0.5
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
        counts: tuple[int, int],
        full_scale: int,
        shortest_s: float,
        noise_m: float,
    ) -> None:
        """`reading_error_m`: by distance (m) and force (N); the pad's clock starts soon after t (s).

        counts: the least and the largest position; full_scale: the largest pressure; shortest_s: between reports.
        """
        self.packets = 0
        self._base, self._options, self._reading_error_m, self._rng = config, options, reading_error_m, rng
        self._range, self._full_scale, self._shortest_s, self._noise_m = counts, full_scale, shortest_s, noise_m
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
            total = sum(press.force for press in felt)
            counts = self._counts(sum(press.s * press.force for press in felt) / total, total)
            across = self._counts_across(sum(press.across * press.force for press in felt) / total)
            said = self._touch(t, counts, across, self._pressure(total))
        self.packets += bool(said)
        return said

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
    def _touch(self, t: float, counts: int, across: int, pressure: int) -> bytes:
        """What is said of a touch, counts along and across the palm."""

    @abstractmethod
    def _untouched(self, t: float, lifted: bool) -> bytes:
        """What is said of none; `lifted` says that there was one."""

    def _feels(self, press: Press) -> bool:
        on_pad = 0.0 < press.s < self._base.length_mm * 1e-3 and abs(press.across) < 0.5 * WIDTH_M
        return on_pad and press.force > self._options.dead_band_n

    def _counts(self, s: float, force: float) -> int:
        config = self._base
        seen_mm = (s + self._reading_error_m(s, force) + float(self._rng.normal(0.0, self._noise_m))) * 1e3
        counts = round(config.sign * (seen_mm - config.zero_mm) * config.counts_per_mm)
        return min(max(counts, self._range[0]), self._range[1])

    def _counts_across(self, across: float) -> int:
        jitter = int(self._rng.integers(-ACROSS_JITTER_COUNTS, ACROSS_JITTER_COUNTS + 1))
        return min(max(round(across * 1e3 * self._base.counts_per_mm) + jitter, self._range[0]), self._range[1])

    def _pressure(self, force: float) -> int:
        options = self._options
        slack = options.hysteresis * force
        self._felt = min(max(self._felt, force - slack), force + slack)
        gain = 1.0 + self._drift + float(self._rng.normal(0.0, options.force_noise))
        counts = round(self._felt * gain / self._base.newtons_per_count)
        return min(max(counts, 1), self._full_scale)

    def _drift_to(self, t: float) -> None:
        """An Ornstein–Uhlenbeck walk of the gain."""
        options = self._options
        keep = math.exp(-(t - self._t_last) / options.force_drift_s)
        kick = options.force_drift * math.sqrt(1.0 - keep * keep)
        self._drift = keep * self._drift + float(self._rng.normal(0.0, kick))
        self._t_last = t


class VersaPadEmulator(PadEmulator):
    """A VersaPad: reports in three bands as long as it is touched, once more when it is let go, or not."""

    def __init__(
        self,
        config: VersaPadConfig,
        options: PadOptions,
        reading_error_m: Callable[[float, float], float],
        rng: np.random.Generator,
        t: float,
    ) -> None:
        """See `PadEmulator`."""
        pressure = config.pressure
        self.baud = config.baud
        self._config = config
        self._format = PressureFormat(pressure.byte, pressure.mask, pressure.shift, pressure.invert)
        self._packet_s = max(PACKET_S, PACKET_BYTES * 10.0 / config.baud)
        super().__init__(
            config, options, reading_error_m, rng, t, counts=(COUNT_MIN, COUNT_MAX),
            full_scale=self._format.full_scale, shortest_s=self._packet_s, noise_m=options.noise_m,
        )  # fmt: skip

    def greeting(self) -> list[tuple[bytes, float]]:
        """Its identity, once for each break that it is to be given."""
        breaks = {"none": 0, "break": 1, "break_twice": 2}[self._config.handshake]
        return [(_IDENTITY, (number + 1) * _IDENTITY_S) for number in range(breaks)]

    def listener(self) -> VersaPadDecoder:
        """Of its packets."""
        return VersaPadDecoder(self._config.baud)

    def _interval(self) -> float:
        band = 1 + bisect(_BANDS_UP_TO, self._rng.random())  # as `choice(3, p=BAND_WEIGHTS)`, and far sooner
        return max(self._packet_s, band * self._packet_s + float(self._rng.normal(0.0, BAND_JITTER_S)))

    def _touch(self, t: float, counts: int, across: int, pressure: int) -> bytes:  # noqa: ARG002
        x, y = (counts, across) if self._config.axis == "x" else (across, counts)
        return encode_packet(x, y, pressure, pressure_format=self._format)

    def _untouched(self, t: float, lifted: bool) -> bytes:  # noqa: ARG002
        if not (lifted and self._options.lift_report == "flag"):
            return b""
        return encode_packet(0, 0, 0, in_use=False, pressure_format=self._format)
