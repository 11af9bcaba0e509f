"""An emulated touchpad: when it reports, and what it makes of a contact. Pure.

A four-wire resistive pad with pressure: it needs a closing force, its pressure drifts and lags, several
contacts merge into one weighted point, positions come in whole counts, and reports fall into three bands of
one, two and three packet times (mean 10 ms, s.d. near 5 ms) on the pad's own clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palmd.config import Config, VersaPadConfig
from palmd.devices.versapad import (
    COUNT_MAX,
    COUNT_MIN,
    PACKET_BYTES,
    PressureFormat,
    encode_packet,
)
from palmd.system.mechanism import PALMS

PACKET_S = 0.00625  # at 9600 baud; a faster line does not make the pad measure faster
BAND_WEIGHTS = (0.64, 0.20, 0.16)  # with the jitter cut off below one packet time, mean 10.0 and s.d. 4.7 ms
BAND_JITTER_S = 0.002
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


def versapads(config: Config) -> tuple[VersaPadConfig, ...]:
    """The pads of a configuration; ValueError for one of a kind that is not emulated here."""
    pads: list[VersaPadConfig] = []
    for palm, pad in zip(PALMS, config.pads.each(), strict=True):
        if not isinstance(pad, VersaPadConfig):
            raise ValueError(f"pads.palm{palm}.kind: the emulated rig has pads of kind versapad only, not {pad.kind}")
        pads.append(pad)
    return tuple(pads)


class PadEmulator:
    """One pad. Ask `due` when it reports next and `report` what it then sends."""

    def __init__(
        self,
        config: VersaPadConfig,
        options: PadOptions,
        reading_error_m: Callable[[float, float], float],
        rng: np.random.Generator,
        t: float,
    ) -> None:
        """`reading_error_m`: by distance (m) and force (N); the pad's clock starts soon after t (s)."""
        pressure = config.pressure
        self.packets = 0
        self._config, self._options, self._reading_error_m, self._rng = config, options, reading_error_m, rng
        self._format = PressureFormat(pressure.byte, pressure.mask, pressure.shift, pressure.invert)
        self._packet_s = max(PACKET_S, PACKET_BYTES * 10.0 / config.baud)
        self._t_last = t
        self._touched = False
        self._drift = float(rng.normal(0.0, options.force_drift))
        self._felt = 0.0
        self.due = t + float(rng.uniform(0.0, 0.01))

    def report(self, t: float, presses: list[Press]) -> bytes:
        """The packet formed at t (s) from what presses on the pad then; empty if the pad is silent."""
        self._drift_to(t)
        self.due = max(self.due + self._interval(), t + self._packet_s)
        felt = [press for press in presses if self._feels(press)]
        if not felt:
            lifted, self._touched, self._felt = self._touched, False, 0.0
            if not (lifted and self._options.lift_report == "flag"):
                return b""
            self.packets += 1
            return encode_packet(0, 0, 0, in_use=False, pressure_format=self._format)
        self._touched = True
        total = sum(press.force for press in felt)
        counts = self._counts(sum(press.s * press.force for press in felt) / total, total)
        across = self._counts_across(sum(press.across * press.force for press in felt) / total)
        x, y = (counts, across) if self._config.axis == "x" else (across, counts)
        self.packets += 1
        return encode_packet(x, y, self._pressure(total), pressure_format=self._format)

    def _feels(self, press: Press) -> bool:
        on_pad = 0.0 < press.s < self._config.length_mm * 1e-3 and abs(press.across) < 0.5 * WIDTH_M
        return on_pad and press.force > self._options.dead_band_n

    def _interval(self) -> float:
        band = 1 + int(self._rng.choice(3, p=BAND_WEIGHTS))
        return max(self._packet_s, band * self._packet_s + float(self._rng.normal(0.0, BAND_JITTER_S)))

    def _counts(self, s: float, force: float) -> int:
        options, config = self._options, self._config
        seen_mm = (s + self._reading_error_m(s, force) + float(self._rng.normal(0.0, options.noise_m))) * 1e3
        counts = round(config.sign * (seen_mm - config.zero_mm) * config.counts_per_mm)
        return min(max(counts, COUNT_MIN), COUNT_MAX)

    def _counts_across(self, across: float) -> int:
        jitter = int(self._rng.integers(-ACROSS_JITTER_COUNTS, ACROSS_JITTER_COUNTS + 1))
        return min(max(round(across * 1e3 * self._config.counts_per_mm) + jitter, COUNT_MIN), COUNT_MAX)

    def _pressure(self, force: float) -> int:
        options = self._options
        slack = options.hysteresis * force
        self._felt = min(max(self._felt, force - slack), force + slack)
        gain = 1.0 + self._drift + float(self._rng.normal(0.0, options.force_noise))
        counts = round(self._felt * gain / self._config.newtons_per_count)
        return min(max(counts, 1), self._format.full_scale)

    def _drift_to(self, t: float) -> None:
        """An Ornstein–Uhlenbeck walk of the gain."""
        options = self._options
        keep = math.exp(-(t - self._t_last) / options.force_drift_s)
        kick = options.force_drift * math.sqrt(1.0 - keep * keep)
        self._drift = keep * self._drift + float(self._rng.normal(0.0, kick))
        self._t_last = t
