"""An emulated VersaPad: the packets of a four-wire resistive pad. Pure.

Reports fall into three bands of one, two and three packet times (mean 10 ms, standard deviation near 5 ms) of the pad's
own clock.
"""

from __future__ import annotations

from bisect import bisect

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
from palmd.rig.pads import CountingPad, EmulatorFactory

PACKET_S = 0.00625  # at 9600 baud; the pad does not measure faster on a faster line
# with the jitter cut off below one packet time: mean 10.0 ms, standard deviation 4.7 ms
BAND_WEIGHTS = (0.64, 0.20, 0.16)
_BANDS_UP_TO: list[float] = np.cumsum(BAND_WEIGHTS).tolist()
BAND_JITTER_S = 0.002
_IDENTITY = b"VPEMU1\r"
_IDENTITY_S = 0.5


class VersaPadEmulator(CountingPad):
    """A VersaPad: reports in three bands while it is touched, and optionally once more on lift-off."""

    _config: VersaPadConfig
    _range = (COUNT_MIN, COUNT_MAX)

    @property
    def baud(self) -> int:
        return self._config.baud

    @property
    def _noise_m(self) -> float:
        return self._options.noise_m

    def _begin(self, t: float) -> None:  # noqa: ARG002
        pressure = self._config.pressure
        self._format = PressureFormat(pressure.byte, pressure.mask, pressure.shift, pressure.invert)
        self._full_scale = self._format.full_scale
        self._packet_s = max(PACKET_S, PACKET_BYTES * 10.0 / self.baud)

    def greeting(self) -> list[tuple[bytes, float]]:
        """The identity, once for each break of the configured handshake."""
        breaks = {"none": 0, "break": 1, "break_twice": 2}[self._config.handshake]
        return [(_IDENTITY, (number + 1) * _IDENTITY_S) for number in range(breaks)]

    def make_decoder(self) -> VersaPadDecoder:
        return VersaPadDecoder(self.baud)

    def _interval(self) -> float:
        band = 1 + bisect(_BANDS_UP_TO, self._rng.random())  # as `choice(3, p=BAND_WEIGHTS)`, but much faster
        return max(self._packet_s, band * self._packet_s + float(self._rng.normal(0.0, BAND_JITTER_S)))

    def _min_interval(self) -> float:
        return self._packet_s

    def _touch_report(self, t: float, counts: int, across: int, pressure: int) -> bytes:  # noqa: ARG002
        x, y = (counts, across) if self._config.axis == "x" else (across, counts)
        return encode_packet(x, y, pressure, pressure_format=self._format)

    def _lifted_report(self, t: float, lifted: bool) -> bytes:  # noqa: ARG002
        if not (lifted and self._options.lift_report == "flag"):
            return b""
        return encode_packet(0, 0, 0, in_use=False, pressure_format=self._format)


EMULATOR: EmulatorFactory = VersaPadEmulator
