"""`kind: strip`: a force-sensing strip read by a microcontroller on a USB serial port."""

from __future__ import annotations

from palmd.config.pads import StripConfig
from palmd.devices.pad import PadFactory
from palmd.devices.serialpad import SerialPad
from palmd.devices.strip import FORCE_MAX, TOUCHED_S, StripCounters, StripDecoder, StripPacket


class Strip(SerialPad[StripPacket, StripCounters]):
    """One strip's line; see `PadDriver`. Its firmware talks by itself."""

    def __init__(self, number: int, config: StripConfig) -> None:
        """Nothing is opened yet."""
        decoder = StripDecoder(config.baud)
        super().__init__(number, config, config.baud, decoder, decoder.counters, TOUCHED_S)

    @property
    def complaint(self) -> str | None:
        """That what came was no report, or of another version."""
        if self._counters.strange:
            return "its firmware is of another version than palmd: flash that of tools/strip"
        if self._counters.discarded:
            return f"{self._counters.discarded} bytes, but no report among them: is it a strip with palmd's firmware?"
        return None

    def _is_place(self, report: StripPacket) -> bool:  # noqa: ARG002
        return True

    def _is_bounded(self, report: StripPacket) -> bool:
        return report.saturated or report.pressure >= FORCE_MAX


DRIVER: PadFactory = Strip
COUNTED = ("bytes", "packets", "discarded")
