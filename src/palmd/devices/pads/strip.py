"""`kind: strip`: a force-sensing strip read by a microcontroller on a USB serial port."""

from __future__ import annotations

from palmd.config.pads import StripConfig
from palmd.devices.pad import PadFactory
from palmd.devices.serialpad import SerialPad
from palmd.devices.strip import FORCE_MAX, TOUCHED_S, StripCounters, StripDecoder, StripPacket


class Strip(SerialPad[StripPacket, StripCounters]):
    """`PadDriver` of one strip, whose firmware sends reports unasked."""

    def __init__(self, number: int, config: StripConfig) -> None:
        decoder = StripDecoder(config.baud)
        super().__init__(number, config, config.baud, decoder, decoder.counters, TOUCHED_S)

    @property
    def diagnosis(self) -> str | None:
        """The bytes received are no reports, or of another protocol version."""
        if self._counters.strange:
            return "its firmware's protocol version differs from palmd's: flash the firmware in tools/strip"
        if self._counters.discarded:
            return f"{self._counters.discarded} bytes, but no report among them: check that it has palmd's firmware"
        return None

    def _is_saturated(self, report: StripPacket) -> bool:
        return report.saturated or report.pressure >= FORCE_MAX


DRIVER: PadFactory = Strip
COUNTER_NAMES = ("bytes", "packets", "discarded")
