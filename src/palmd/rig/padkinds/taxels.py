"""An emulated array of pressure sensors: what each taxel counts for a contact, in the bytes of its protocol. Pure.

The pressure of a contact is parabolic along the palm (Hertz) and uniform across it, and its width grows with the force.
Width and taxel sensitivities are drawn about the configured values; the host assumes another pressure profile.
"""

from __future__ import annotations

import math

import numpy as np

from palmd.config.pads import TaxelsConfig
from palmd.devices import taxels
from palmd.devices.framing import FrameScanner, Head
from palmd.devices.taxels import TaxelDecoder, modbus_crc, modbus_frame, tsf85_field, tsf85_frame
from palmd.events import FloatArray
from palmd.rig.pads import EmulatorFactory, PadEmulator, Press

ANSWER_S = 2e-4  # from the end of the request to the start of the answer
WIDTH_SD = 0.15  # standard deviation of the width's logarithm between arrays
WIDTH_EXPONENT = 1.0 / 6.0  # exponent of the force with which the width of a contact grows
COUNT_SD = 0.3  # noise of a taxel, in counts


class TaxelEmulator(PadEmulator):
    """A taxel array with noise as configured, which speaks the configured protocol."""

    _config: TaxelsConfig
    _jitter_s = 2e-4

    @property
    def baud(self) -> int:
        return self._config.line_baud

    def _begin(self, t: float) -> None:  # noqa: ARG002
        config, rng = self._config, self._rng
        self._report_s = config.report_s
        self._protocol = _PROTOCOLS[config.protocol](config)
        self._width_mm = config.contact_width_mm * math.exp(WIDTH_SD * float(rng.standard_normal()))
        self._gains = 1.0 + config.taxel_gain_sd * rng.standard_normal((config.rows, config.columns))
        self.due = self._protocol.due(self.due, 0.0)

    def make_decoder(self) -> TaxelDecoder:
        return TaxelDecoder(self._config)

    def receive(self, data: bytes, t: float) -> None:
        """Receive a command or a request."""
        if self._protocol.receive(data, t):
            self.due = t + ANSWER_S

    def _interval(self) -> float:
        return self._protocol.due(self.due, super()._interval()) - self.due

    def _min_interval(self) -> float:
        return 0.0

    def _contact_report(self, t: float, contacts: list[Press]) -> bytes:
        array = np.zeros_like(self._gains)
        for press in contacts:
            array += self._taxel_forces(press)
        return self._report(t, array)

    def _lifted_report(self, t: float, lifted: bool) -> bytes:  # noqa: ARG002
        return self._report(t, np.zeros_like(self._gains))

    def _taxel_forces(self, press: Press) -> FloatArray:
        """Force (N) by taxel."""
        config = self._config
        measured_mm = self._measured_position_m(press.s, press.force) * 1e3
        force = self._measured_force_n(press.force)
        centre_mm = config.sign * (measured_mm - config.zero_mm) * config.counts_per_mm / taxels.UM_PER_MM
        # of a parabola with that standard deviation
        half_width = math.sqrt(5.0) * self._width_mm * press.force**WIDTH_EXPONENT
        edges = (np.arange(config.rows + 1) - 0.5) * config.pitch_mm
        shares = np.diff(_parabola((edges - centre_mm) / half_width))
        return np.asarray(force * shares[:, None] / config.columns * self._gains)

    def _report(self, t: float, newtons: FloatArray) -> bytes:
        config = self._config
        noise = self._rng.normal(0.0, COUNT_SD, newtons.shape)
        counts = np.rint(newtons / config.newtons_per_count + config.rest_counts + noise)
        return self._protocol.encode(np.clip(counts, 0, config.full_scale_counts).astype(int), t)


def _parabola(x: FloatArray) -> FloatArray:
    """Share of a parabolic pressure over −1 to 1 that lies below x."""
    inside = np.clip(x, -1.0, 1.0)
    return np.asarray(0.5 + 0.25 * inside * (3.0 - inside**2))


class _Tsf85:
    """Sends periodically after it has been commanded to."""

    def __init__(self, config: TaxelsConfig) -> None:
        self._modules = config.rows // taxels.TSF85_ROWS
        self._period_ms = 0
        self._commands = FrameScanner(config.line_baud, _command_size, lambda _raw: True, first_byte=taxels.TSF85_START)

    def receive(self, data: bytes, t: float) -> bool:
        for _, raw in self._commands.feed(data, t):
            self._period_ms = raw[4]
        return self._period_ms > 0

    def due(self, t: float, wait_s: float) -> float:
        return t + wait_s if self._period_ms else math.inf

    def encode(self, counts: np.ndarray[tuple[int, ...], np.dtype[np.int_]], t: float) -> bytes:
        fields = b""
        for module in range(self._modules):
            own = counts[module * taxels.TSF85_ROWS : (module + 1) * taxels.TSF85_ROWS]
            fields += tsf85_field(taxels.PRESSURES, module, own.astype(">u2").tobytes())
            for kind in (taxels.VIBRATION, taxels.ACCELERATION, taxels.RATE, taxels.TEMPERATURE):
                fields += tsf85_field(kind, module, bytes(taxels.TSF85_FIELD_BYTES[kind]))
            fields += tsf85_field(taxels.TIME, module, int(t * 1e3).to_bytes(8, "big"))
        return tsf85_frame(taxels.TSF85_AUTOSEND, fields)


def _command_size(head: Head) -> int | None:
    if len(head) < 4:
        return None
    return 5 if head[2] == taxels.TSF85_AUTOSEND and head[3] == 1 else 0


class _St0001:
    """Answers requests; values are in millinewtons once selected, before that in converter counts, a fifth as large."""

    def __init__(self, config: TaxelsConfig) -> None:
        self._requests = FrameScanner(config.line_baud, _request_size, _has_crc, first_byte=taxels.ST0001_ADDRESS)
        self._answers = b""
        self._is_requested = self._millinewtons = False

    def receive(self, data: bytes, t: float) -> bool:
        for _, raw in self._requests.feed(data, t):
            if raw[1] == taxels.READ_PRESSURES:
                self._is_requested = True
            else:
                register, value = int.from_bytes(raw[2:4], "big"), int.from_bytes(raw[4:6], "big")
                self._millinewtons |= register == taxels.VALUE_TYPE and value == taxels.MILLINEWTONS
                self._answers += raw
        return self._is_requested or bool(self._answers)

    def due(self, t: float, wait_s: float) -> float:  # noqa: ARG002
        return math.inf

    def encode(self, counts: np.ndarray[tuple[int, ...], np.dtype[np.int_]], t: float) -> bytes:  # noqa: ARG002
        data, self._answers = self._answers, b""
        if self._is_requested:
            values = counts if self._millinewtons else counts // 5
            raw = values.astype("<u2").tobytes()
            data += modbus_frame(taxels.READ_PRESSURES, len(raw).to_bytes(2, "little") + raw)
        self._is_requested = False
        return data


def _request_size(head: Head) -> int | None:
    if len(head) < 2:
        return None
    return {taxels.READ_PRESSURES: 4, taxels.WRITE_REGISTER: 8}.get(head[1], 0)


def _has_crc(raw: bytes) -> bool:
    return modbus_crc(raw[:-2]) == int.from_bytes(raw[-2:], "little")


class _Text:
    """Sends one line per frame."""

    def __init__(self, config: TaxelsConfig) -> None:
        """The configuration is not needed."""

    def receive(self, data: bytes, t: float) -> bool:  # noqa: ARG002
        return False

    def due(self, t: float, wait_s: float) -> float:
        return t + wait_s

    def encode(self, counts: np.ndarray[tuple[int, ...], np.dtype[np.int_]], t: float) -> bytes:  # noqa: ARG002
        return " ".join(map(str, counts.ravel())).encode() + b"\n"


_PROTOCOLS: dict[str, type[_Tsf85 | _St0001 | _Text]] = {"tsf85": _Tsf85, "st0001": _St0001, "text": _Text}

EMULATOR: EmulatorFactory = TaxelEmulator
