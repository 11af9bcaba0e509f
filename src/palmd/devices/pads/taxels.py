"""`kind: taxels`: an array of pressure sensors on a serial line."""

from __future__ import annotations

import math

from palmd.config.pads import TaxelsConfig
from palmd.devices.pad import HostLine, PadFactory
from palmd.devices.serialpad import SerialPad
from palmd.devices.taxels import ANSWER_S, TaxelCounters, TaxelDecoder, TaxelReport

OPENING_S = 1.0
"""An array that has sent no frame for so long is configured again: it may have been restarted."""


class Taxels(SerialPad[TaxelReport, TaxelCounters]):
    """One array's line; see `PadDriver`. An array that does not speak by itself is asked for each frame."""

    def __init__(self, number: int, config: TaxelsConfig) -> None:
        """Nothing is opened yet."""
        self._taxels = decoder = TaxelDecoder(config)
        super().__init__(number, config, config.line_baud, decoder, decoder.counters, config.report_s)
        self._config = config
        self._t_opening = self._t_asked = -math.inf
        self._t_frame = -math.inf
        self._frames_asked = 0  # how many frames had come when it was asked last

    @property
    def complaint(self) -> str | None:
        """That what came was no frame, or that questions are not answered."""
        counters, config = self._counters, self._config
        if counters.refusals:
            return f"{counters.refusals} of its answers are Modbus exceptions: is it an ST-00-01 at address 1?"
        if counters.discarded:
            return (
                f"{counters.discarded} bytes, but no frame of {config.rows} x {config.columns} taxels among them at"
                f" {config.line_baud} baud: check protocol, rows, columns and baud"
            )
        if counters.unanswered:
            return f"{counters.unanswered} questions without an answer: check baud and wiring"
        return None

    def opened(self, t: float) -> None:
        """The port has been opened at `t` (s): the array is configured next."""
        super().opened(t)
        self._t_opening = self._t_asked = self._t_frame = -math.inf

    def tend(self, port: HostLine, t: float) -> None:
        """Configure the array, and ask it for the next frame once the last answer has come."""
        if not self.is_open:
            return
        counters, protocol = self._counters, self._taxels.protocol
        if t - max(self._t_opening, self._t_frame) > OPENING_S and (opening := protocol.opening()):
            self._t_opening = self._t_asked = t
            port.write(opening)
            return
        question = protocol.question()
        if not question:
            return
        answered = counters.packets > self._frames_asked
        if answered or t - self._t_asked > ANSWER_S:
            counters.unanswered += not answered and math.isfinite(self._t_asked)
            self._t_asked, self._frames_asked = t, counters.packets
            port.write(question)

    def reports(self, data: bytes, t: float) -> list[TaxelReport]:
        """The reports in the bytes read at `t` (s), touched or not."""
        found = list(super().reports(data, t))
        if found:
            self._t_frame = t
        return found

    def _is_place(self, report: TaxelReport) -> bool:
        return not report.unplaced

    def _is_bounded(self, report: TaxelReport) -> bool:
        return report.saturated


DRIVER: PadFactory = Taxels
COUNTED = ("bytes", "packets", "discarded")
NOTE = (
    "an array of pressure sensors feels every object; its error of place repeats with the pitch, so choose a skin that"
    " spreads a contact over half a pitch or more"
)
