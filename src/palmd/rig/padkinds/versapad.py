"""An emulated VersaPad: the packets of a four-wire resistive pad. Pure.

Reports fall into three bands of one, two and three packet times (mean 10 ms, standard deviation near 5 ms) of the pad's
own clock.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Callable

import numpy as np

from palmd.config.pads import VersaPadConfig
from palmd.devices.versapad import (
    COUNT_MAX,
    COUNT_MIN,
    PACKET_BYTES,
    PressureFormat,
    VersaPadDecoder,
    encode_packet,
)
from palmd.rig.pads import CountingPad, EmulatorFactory, PadOptions

PACKET_S = 0.00625  # at 9600 baud; the pad does not measure faster on a faster line
# with the jitter cut off below one packet time: mean 10.0 ms, standard deviation 4.7 ms
BAND_WEIGHTS = (0.64, 0.20, 0.16)
_BANDS_UP_TO: list[float] = np.cumsum(BAND_WEIGHTS).tolist()
BAND_JITTER_S = 0.002
_IDENTITY = b"VPEMU1\r"
_IDENTITY_S = 0.5


class VersaPadEmulator(CountingPad):
    """A VersaPad: reports in three bands while it is touched, and optionally once more on lift-off."""

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
            full_scale=self._format.full_scale, min_interval_s=self._packet_s, noise_m=options.noise_m,
        )  # fmt: skip

    def greeting(self) -> list[tuple[bytes, float]]:
        """The identity, once for each break of the configured handshake."""
        breaks = {"none": 0, "break": 1, "break_twice": 2}[self._config.handshake]
        return [(_IDENTITY, (number + 1) * _IDENTITY_S) for number in range(breaks)]

    def make_decoder(self) -> VersaPadDecoder:
        """A new decoder of its packets."""
        return VersaPadDecoder(self._config.baud)

    def _interval(self) -> float:
        band = 1 + bisect(_BANDS_UP_TO, self._rng.random())  # as `choice(3, p=BAND_WEIGHTS)`, but much faster
        return max(self._packet_s, band * self._packet_s + float(self._rng.normal(0.0, BAND_JITTER_S)))

    def _touch_report(self, t: float, counts: int, across: int, pressure: int) -> bytes:  # noqa: ARG002
        x, y = (counts, across) if self._config.axis == "x" else (across, counts)
        return encode_packet(x, y, pressure, pressure_format=self._format)

    def _lifted_report(self, t: float, lifted: bool) -> bytes:  # noqa: ARG002
        if not (lifted and self._options.lift_report == "flag"):
            return b""
        return encode_packet(0, 0, 0, in_use=False, pressure_format=self._format)


EMULATOR: EmulatorFactory = VersaPadEmulator
