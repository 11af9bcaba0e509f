"""Decoder of pressure sensor arrays: three protocols in, position and force of the contact out. Pure, safe in the loop.

`tsf85`: sensor TSF-85 (7 x 4 taxels a module, up to two modules on one line), which sends frames unasked:

    9A | checksum | command | length | fields
    field: type (high four bits) and module (bits 2, 3), then big-endian numbers: 10 pressures 28 x 2 bytes,
    20 vibration 2, 30 acceleration 6, 40 rate 6, 50 magnetic field 6, 60 temperature 2, 70 time 8

The manufacturer's programs compute no checksum, so none is checked; a frame must consist of known fields exactly.
The host starts the stream with command 58 and the period in ms.

`st0001`: module ST-00-01 (60 taxels), Modbus RTU with the user-defined function 42, polled by the host:

    address 42 | CRC           ->  address 42 | length, 2 bytes | 60 x 2 bytes | CRC     little-endian, CRC-16/MODBUS
    address 06 00 0D 00 01 | CRC   register 13 = 1: values are millinewtons instead of converter counts

`text`: one line per frame, rows x columns integers row by row, separated by spaces, tabs, commas or semicolons.

Sources: docs/reference/devices.md.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palmd.config.pads import TaxelsConfig
from palmd.devices.framing import FrameCounters, FrameScanner, Head, crc_table
from palmd.devices.pad import PadReport
from palmd.events import FloatArray

UM_PER_MM = 1000.0
MIN_SLOPE = 0.8
"""Smallest slope of centroid over position: near the array's ends it falls, and errors grow by a quarter at 0.8."""

WINDOW_SIGMAS = 4.0
"""Half width of the window: rows beyond it hold 0.1 % of a logistic profile's pressure and only add noise."""

MIN_SHARE = 0.8
"""Smallest share of pressure in the window for one contact; a profile twice as wide as configured has 97 %."""

_CELL_STEPS = 16  # per pitch, for integrating the profile

TSF85_START, TSF85_AUTOSEND = 0x9A, 0x58
TSF85_COMMANDS = (TSF85_AUTOSEND, 0x59, 0x61)
TSF85_ROWS, TSF85_COLUMNS = 7, 4
PRESSURES, VIBRATION, ACCELERATION, RATE, MAGNETIC_FIELD, TEMPERATURE, TIME = range(0x10, 0x80, 0x10)
TSF85_FIELD_BYTES: Mapping[int, int] = {
    PRESSURES: 2 * TSF85_ROWS * TSF85_COLUMNS, VIBRATION: 2, ACCELERATION: 6, RATE: 6, MAGNETIC_FIELD: 6,
    TEMPERATURE: 2, TIME: 8,
}  # fmt: skip
TSF85_MODULES = 2
_TSF85_HEAD = 4

ST0001_ADDRESS, ST0001_TAXELS = 1, 60
READ_PRESSURES, WRITE_REGISTER, EXCEPTION = 0x42, 0x06, 0x80
VALUE_TYPE, MILLINEWTONS = 0x000D, 1
ANSWER_S = 0.030
"""Timeout of an answer (s), which takes 0.3 ms on the line and up to 16 ms in a slow adapter."""

MAX_DIGITS = 6
_NUMBER = rb"\d{1,%d}" % MAX_DIGITS
_NUMBERS = re.compile(rb"[ \t]*%b(?:[ \t]*[,; \t][ \t]*%b)*[ \t]*[,;]?[ \t]*\r?\n" % (_NUMBER, _NUMBER))


@dataclass(frozen=True, slots=True)
class TaxelReport(PadReport):
    """One frame: `x_counts` is the position in micrometres from the middle of the first row.

    `pressure` is the sum of all taxels less their counts at rest. unlocated: several contacts, or one so close to an
    end of the array that its position is unknown. saturated: a taxel is at full scale.
    """

    unlocated: bool
    saturated: bool


@dataclass(slots=True)
class TaxelCounters(FrameCounters):
    """Counters of an array's line, in addition to those of `FrameCounters`.

    `batches` counts reads with several frames, `batched` the frames in them, `out_of_range` positions that are not on
    the pad, `refusals` answers that are Modbus exceptions, `unanswered` requests without an answer in time.
    """

    batches: int = 0
    batched: int = 0
    out_of_range: int = 0
    refusals: int = 0
    unanswered: int = 0


class TaxelProtocol(ABC):
    """Protocol of one device: the functions that `FrameScanner` needs, and the content of a frame."""

    first_byte: int | None = None
    discard_whole = False
    refusals = 0
    """Number of answers that were exceptions."""

    def __init__(self, config: TaxelsConfig) -> None:
        self._config = config

    @abstractmethod
    def size(self, head: Head) -> int | None:
        """See `FrameScanner`."""

    def is_valid(self, frame: bytes) -> bool:  # noqa: ARG002
        """See `FrameScanner`; without a checksum, `size` checks what there is."""
        return True

    @abstractmethod
    def pressures(self, frame: bytes) -> Sequence[int] | None:
        """Return the counts of all taxels, row by row, if this frame completes them; else None."""

    def startup(self) -> bytes:
        """Return what the host sends after the line has been opened; empty if frames are sent at once."""
        return b""

    def request(self) -> bytes:
        """Return what the host sends to request a frame; empty if frames are sent unasked."""
        return b""

    def forget(self) -> None:  # noqa: B027
        """Discard state after an interruption of the line."""


class Tsf85(TaxelProtocol):
    """TSF-85: one or two modules, the second one farther from the hinge."""

    first_byte = TSF85_START

    def __init__(self, config: TaxelsConfig) -> None:
        super().__init__(config)
        self._modules = config.rows // TSF85_ROWS
        self._period_ms = round(config.report_s * 1e3)
        self._found: dict[int, bytes] = {}

    def size(self, head: Head) -> int | None:
        """By the length in the header; 0 if the fields received so far are invalid."""
        if len(head) > 2 and head[2] not in TSF85_COMMANDS:
            return 0
        if len(head) < _TSF85_HEAD:
            return None
        end = _TSF85_HEAD + head[3]
        at = _TSF85_HEAD
        while at < min(end, len(head)):
            size = TSF85_FIELD_BYTES.get(head[at] & 0xF0)
            if size is None or (head[at] >> 2 & 0x03) >= TSF85_MODULES or at + 1 + size > end:
                return 0
            at += 1 + size
        return end if end > _TSF85_HEAD else 0

    def pressures(self, frame: bytes) -> Sequence[int] | None:
        """Once the fields of every module have arrived."""
        at = _TSF85_HEAD
        while at < len(frame):
            kind, module, size = frame[at] & 0xF0, frame[at] >> 2 & 0x03, TSF85_FIELD_BYTES[frame[at] & 0xF0]
            if kind == PRESSURES and module < self._modules:
                self._found[module] = frame[at + 1 : at + 1 + size]
            at += 1 + size
        if len(self._found) < self._modules:
            return None
        raw = b"".join(self._found[module] for module in range(self._modules))
        self._found.clear()
        return np.frombuffer(raw, ">u2").tolist()  # type: ignore[no-any-return]

    def startup(self) -> bytes:
        """Start the stream of frames."""
        return tsf85_frame(TSF85_AUTOSEND, bytes((self._period_ms,)))

    def forget(self) -> None:
        """Discard an incomplete set of modules."""
        self._found.clear()


def tsf85_frame(command: int, data: bytes) -> bytes:
    """Encode a frame, with checksum 0 as in the manufacturer's programs. Raises ValueError above 255 bytes of data."""
    if len(data) > 0xFF:
        raise ValueError(f"a frame has at most 255 bytes of data, not {len(data)}")
    return bytes((TSF85_START, 0, command, len(data))) + data


def tsf85_field(kind: int, module: int, data: bytes) -> bytes:
    """Encode a field with its type byte."""
    return bytes((kind | module << 2,)) + data


class St0001(TaxelProtocol):
    """ST-00-01 on its own line, polled for every frame."""

    first_byte = ST0001_ADDRESS

    def size(self, head: Head) -> int | None:
        """By the function code of the answer."""
        if len(head) < 2:
            return None
        if head[1] == READ_PRESSURES:
            if len(head) < 4:
                return None
            return 4 + 2 * ST0001_TAXELS + 2 if int.from_bytes(head[2:4], "little") == 2 * ST0001_TAXELS else 0
        if head[1] == WRITE_REGISTER:
            return 8
        return 5 if head[1] in (READ_PRESSURES | EXCEPTION, WRITE_REGISTER | EXCEPTION) else 0

    def is_valid(self, frame: bytes) -> bool:
        """Check the CRC."""
        return modbus_crc(frame[:-2]) == int.from_bytes(frame[-2:], "little")

    def pressures(self, frame: bytes) -> Sequence[int] | None:
        """From answers to `request`; other answers contain none."""
        self.refusals += bool(frame[1] & EXCEPTION)
        if frame[1] != READ_PRESSURES:
            return None
        return np.frombuffer(frame[4:-2], "<u2").tolist()  # type: ignore[no-any-return]

    def startup(self) -> bytes:
        """Request values in millinewtons."""
        return modbus_frame(WRITE_REGISTER, VALUE_TYPE.to_bytes(2, "big") + MILLINEWTONS.to_bytes(2, "big"))

    def request(self) -> bytes:
        """Request all pressures."""
        return modbus_frame(READ_PRESSURES, b"")


def modbus_crc(data: bytes) -> int:
    """CRC-16/MODBUS: polynomial 8005 reflected, initial value FFFF."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _MODBUS[(crc ^ byte) & 0xFF]
    return crc


_MODBUS = crc_table(0xA001, 16, reflected=True)


def modbus_frame(function: int, data: bytes) -> bytes:
    """Encode a request or an answer with its CRC."""
    body = bytes((ST0001_ADDRESS, function)) + data
    return body + modbus_crc(body).to_bytes(2, "little")


class TextLines(TaxelProtocol):
    """Lines of numbers; other lines are discarded, and so is the first one, which may be incomplete."""

    discard_whole = True

    def __init__(self, config: TaxelsConfig) -> None:
        super().__init__(config)
        self._count = config.rows * config.columns
        self._longest = self._count * (MAX_DIGITS + 2) + 2
        self._cut = True

    def size(self, head: Head) -> int | None:
        """Up to the end of the line; 0 if there is none within the largest length."""
        end = head.find(b"\n", 0, self._longest)
        if end >= 0:
            return end + 1
        return None if len(head) < self._longest else 0

    def is_valid(self, frame: bytes) -> bool:
        """Whether the line is complete and has one number per taxel."""
        cut, self._cut = self._cut, False
        return not cut and _NUMBERS.fullmatch(frame) is not None and len(re.findall(rb"\d+", frame)) == self._count

    def pressures(self, frame: bytes) -> Sequence[int] | None:
        """Return all numbers of the line."""
        return [int(number) for number in re.findall(rb"\d+", frame)]

    def forget(self) -> None:
        """Treat the next line as possibly incomplete."""
        self._cut = True


PROTOCOLS: Mapping[str, type[TaxelProtocol]] = {"tsf85": Tsf85, "st0001": St0001, "text": TextLines}


class AxisCentroid:
    """Position of a contact along one axis, from the centroid of the rows' pressure sums.

    The array's ends truncate the profile, which shifts the centroid inwards; this is corrected for a logistic profile
    of the configured width. The grid's own error is not corrected, since it depends on the profile's true shape.
    """

    def __init__(self, count: int, config: TaxelsConfig) -> None:
        """`count` is the number of rows along the axis."""
        pitch_mm, scale_mm = config.pitch_mm, config.profile_scale_mm
        self._rows_mm = np.arange(count) * pitch_mm
        self._window_mm = WINDOW_SIGMAS * config.contact_width_mm + 0.5 * pitch_mm
        edges = np.linspace(-0.5, count - 0.5, count * _CELL_STEPS + 1) * pitch_mm
        middles = 0.5 * (edges[1:] + edges[:-1])
        shares = np.diff(_logistic((edges[None, :] - middles[:, None]) / scale_mm), axis=1)
        centroid = shares @ middles / shares.sum(axis=1)
        valid = np.gradient(centroid, middles) >= MIN_SLOPE
        self._centroids, self._positions = centroid[valid], middles[valid]

    def position_mm(self, sums: FloatArray, total: float) -> float | None:
        """Position (mm) from the middle of the first row; None for several contacts or one too close to an end."""
        rows = self._rows_mm
        near = np.abs(rows - float(sums @ rows) / total) <= self._window_mm
        part = float(sums[near].sum())
        if part < MIN_SHARE * total:
            return None
        centroid = float(sums[near] @ rows[near]) / part
        if not self._centroids[0] <= centroid <= self._centroids[-1]:
            return None
        return float(np.interp(centroid, self._centroids, self._positions))


def _logistic(x: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))


class TaxelDecoder:
    """Decodes an array's bytes into reports; garbage is only counted."""

    def __init__(self, config: TaxelsConfig) -> None:
        """The configured baud rate is used for timestamps."""
        self.counters = TaxelCounters()
        self.protocol = protocol = PROTOCOLS[config.protocol](config)
        self._scanner = FrameScanner(
            config.line_baud, protocol.size, protocol.is_valid, first_byte=protocol.first_byte,
            discard_whole=protocol.discard_whole, counters=self.counters,
        )  # fmt: skip
        self._along = AxisCentroid(config.rows, config)
        self._config = config
        self._touched = False

    @property
    def pending(self) -> int:
        """Number of buffered bytes of an incomplete frame."""
        return self._scanner.pending

    def feed(self, data: bytes, t_recv: float) -> list[TaxelReport]:
        """Process the bytes read at `t_recv` (s, monotonic) and return the reports that they complete."""
        frames = self._scanner.feed(data, t_recv)
        found = [(t, counts) for t, raw in frames if (counts := self.protocol.pressures(raw)) is not None]
        batched = len(found) > 1
        self.counters.batches += batched
        self.counters.batched += batched * len(found)
        self.counters.refusals = self.protocol.refusals
        return [self._report(t, t_recv, counts, batched) for t, counts in found]

    def reset(self) -> None:
        """Discard the incomplete frame after an interruption of the line."""
        self._scanner.reset()
        self.protocol.forget()
        self._touched = False

    def _report(self, t_first: float, t_recv: float, counts: Sequence[int], batched: bool) -> TaxelReport:
        config = self._config
        array = np.array(counts, dtype=np.float64).reshape(config.rows, config.columns)
        saturated = bool(array.max() >= config.full_scale_counts)
        array -= config.rest_counts
        total = float(array.sum())
        force, least = total * config.newtons_per_count, config.touch_n
        self._touched = force > (0.5 * least if self._touched else least)
        position_mm = self._along.position_mm(array.sum(axis=1), total) if self._touched else None
        return TaxelReport(
            t_first=t_first,
            t_recv=t_recv,
            x_counts=0 if position_mm is None else round(position_mm * UM_PER_MM),
            y_counts=0,
            pressure=round(total) if self._touched else 0,
            in_use=self._touched,
            batched=batched,
            unlocated=self._touched and position_mm is None,
            saturated=saturated,
        )
