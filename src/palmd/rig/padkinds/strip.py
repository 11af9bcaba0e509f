"""An emulated force-sensing strip behind its microcontroller. Pure."""

from __future__ import annotations

from palmd.config.pads import StripConfig
from palmd.devices.strip import FORCE_MAX, POSITION_MAX, TOUCHED_S, UNTOUCHED_S, StripDecoder, encode
from palmd.rig.pads import CountingPad, EmulatorFactory


class StripEmulator(CountingPad):
    """A strip: reports at a constant rate, more slowly while it is not touched; noise as configured."""

    _config: StripConfig
    _range, _full_scale = (0, POSITION_MAX), FORCE_MAX
    _report_s, _jitter_s = TOUCHED_S, 1e-4
    _sequence = 0

    @property
    def baud(self) -> int:
        return self._config.baud

    def _begin(self, t: float) -> None:
        self._t_idle_report = t

    def make_decoder(self) -> StripDecoder:
        return StripDecoder(self.baud)

    def _touch_report(self, t: float, counts: int, across: int, pressure: int) -> bytes:  # noqa: ARG002
        return self._packet(counts, pressure, touched=True)

    def _lifted_report(self, t: float, lifted: bool) -> bytes:
        if not (lifted or t - self._t_idle_report >= UNTOUCHED_S):
            return b""
        self._t_idle_report = t
        return self._packet(0, 0, touched=False)

    def _packet(self, position: int, force: int, *, touched: bool) -> bytes:
        self._sequence = (self._sequence + 1) % 256
        return encode(position, force, self._sequence, touched=touched, saturated=force >= FORCE_MAX)


EMULATOR: EmulatorFactory = StripEmulator
