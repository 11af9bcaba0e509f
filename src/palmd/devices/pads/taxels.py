"""`kind: taxels`: an array of pressure sensors on a serial line."""

from __future__ import annotations

import math

from palmd.config.pads import TaxelsConfig
from palmd.devices.pad import HostLine, PadFactory
from palmd.devices.serialpad import SerialPad
from palmd.devices.taxels import ANSWER_S, TaxelCounters, TaxelDecoder, TaxelReport

RECONFIGURE_S = 1.0
"""Time without a frame (s) after which the array is configured again, since it may have restarted."""


class Taxels(SerialPad[TaxelReport, TaxelCounters]):
    """`PadDriver` of one array; an array that does not send frames unasked is polled."""

    def __init__(self, number: int, config: TaxelsConfig) -> None:
        self._taxels = decoder = TaxelDecoder(config)
        super().__init__(number, config, config.line_baud, decoder, decoder.counters, config.report_s)
        self._config = config
        self._t_startup = self._t_request = -math.inf
        self._t_frame = -math.inf
        self._frames_at_request = 0  # number of frames received when it was polled last

    @property
    def diagnosis(self) -> str | None:
        """The bytes received are no frames, or requests are not answered."""
        counters, config = self._counters, self._config
        if counters.refusals:
            return (
                f"{counters.refusals} of its answers are Modbus exceptions: check that it is an ST-00-01 at address 1"
            )
        if counters.discarded:
            return (
                f"{counters.discarded} bytes, but no frame of {config.rows} x {config.columns} taxels among them at"
                f" {config.line_baud} baud: check protocol, rows, columns and baud"
            )
        if counters.unanswered:
            return f"{counters.unanswered} requests without an answer: check baud and wiring"
        return None

    def opened(self, t: float) -> None:
        """Handle the opening of the port at `t` (s); the array is configured next."""
        super().opened(t)
        self._t_startup = self._t_request = self._t_frame = -math.inf

    def tend(self, port: HostLine, t: float) -> None:
        """Configure the array, and request the next frame once the last one has arrived."""
        if not self.is_open:
            return
        counters, protocol = self._counters, self._taxels.protocol
        if t - max(self._t_startup, self._t_frame) > RECONFIGURE_S and (startup := protocol.startup()):
            self._t_startup = self._t_request = t
            port.write(startup)
            return
        request = protocol.request()
        if not request:
            return
        answered = counters.packets > self._frames_at_request
        if answered or t - self._t_request > ANSWER_S:
            counters.unanswered += not answered and math.isfinite(self._t_request)
            self._t_request, self._frames_at_request = t, counters.packets
            port.write(request)

    def reports(self, data: bytes, t: float) -> list[TaxelReport]:
        """Return the reports in the bytes read at `t` (s), touched or not."""
        found = list(super().reports(data, t))
        if found:
            self._t_frame = t
        return found

    def _has_position(self, report: TaxelReport) -> bool:
        return not report.unlocated

    def _is_saturated(self, report: TaxelReport) -> bool:
        return report.saturated


DRIVER: PadFactory = Taxels
COUNTER_NAMES = ("bytes", "packets", "discarded")
NOTE = (
    "an array of pressure sensors senses every object; its position error repeats with the pitch, so choose a skin that"
    " spreads a contact over half a pitch or more"
)
