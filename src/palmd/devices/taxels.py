"""Arrays of pressure sensors: three protocols in, the place and the force of the contact out. Pure, safe in the loop.

`tsf85`, of the sensor TSF-85 (7 x 4 taxels a module, up to two modules on one line), frames sent by themselves:

    9A | checksum | command | length | fields
    field: type (high four bits) and module (bits 2, 3), then big-endian numbers: 10 pressures 28 x 2 bytes,
    20 vibration 2, 30 acceleration 6, 40 rate 6, 50 magnetic field 6, 60 temperature 2, 70 time 8

The maker's own programs compute no checksum, so none is checked: a frame must be tiled exactly by known fields.
The host starts the stream with command 58 and the period in ms.

`st0001`, of the module ST-00-01 (60 taxels), Modbus RTU with the user-defined function 42, asked by the host:

    address 42 | CRC           ->  address 42 | length, 2 bytes | 60 x 2 bytes | CRC     little-endian, CRC-16/MODBUS
    address 06 00 0D 00 01 | CRC   register 13 = 1: values are millinewtons instead of converter counts

`text`: a line for each frame, rows x columns whole numbers row by row; between them spaces, tabs, commas or semicolons.

Sources: docs/reference/devices.md.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from palmd.config.pads import TaxelsConfig
from palmd.devices.framing import FrameCounters, FrameScanner, Head
from palmd.devices.pad import PadReport
from palmd.events import FloatArray

UM_PER_MM = 1000.0
LEAST_SLOPE = 0.8
"""Near the array's ends a centroid moves less than the contact: where by less than this, errors grow by a quarter."""

WINDOW_SIGMAS = 4.0
"""Rows so far from the contact hold 0.1 % of its pressure and only add noise (of a logistic profile, by its width)."""

LEAST_SHARE = 0.8
"""A profile twice as wide as configured has 97 % of its pressure in the window; less than this is not one contact."""

_CELL_STEPS = 16  # of a pitch, in which the profile is summed up

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
"""An answer that has not come within so long will not come: it takes 0.3 ms on the line and 16 ms in a slow adapter."""

MOST_DIGITS = 6
_NUMBER = rb"\d{1,%d}" % MOST_DIGITS
_NUMBERS = re.compile(rb"[ \t]*%b(?:[ \t]*[,; \t][ \t]*%b)*[ \t]*[,;]?[ \t]*\r?\n" % (_NUMBER, _NUMBER))


@dataclass(frozen=True, slots=True)
class TaxelReport(PadReport):
    """One frame: `x_counts` is the place in micrometres from the middle of the first row.

    `pressure` is the sum of all taxels less what they count at rest. unplaced: several contacts, or one so near to an
    end of the array that its place is not known. saturated: a taxel is at its full scale.
    """

    unplaced: bool
    saturated: bool


@dataclass(slots=True)
class TaxelCounters(FrameCounters):
    """What an array's line has brought: frames and bytes as `FrameCounters` has them, all bytes accounted for.

    `batches` counts reads with several frames, `batched` the frames in them, `out_of_range` places that are not on the
    pad, `refusals` answers that are Modbus exceptions, `unanswered` questions that nothing answered in time.
    """

    batches: int = 0
    batched: int = 0
    out_of_range: int = 0
    refusals: int = 0
    unanswered: int = 0


class TaxelProtocol(Protocol):
    """How one device speaks: `size` and `is_sound` as a `FrameScanner` needs them, and what a frame says."""

    begins: int | None
    whole: bool
    refusals: int
    """Answers so far that were exceptions."""

    def size(self, head: Head) -> int | None:
        """See `FrameScanner`."""

    def is_sound(self, frame: bytes) -> bool:
        """See `FrameScanner`."""

    def pressures(self, frame: bytes) -> Sequence[int] | None:
        """Every taxel's count, row by row, where this frame completes them."""

    def opening(self) -> bytes:
        """What the host says when the line has been opened."""

    def question(self) -> bytes:
        """What the host says for each frame; empty where frames come by themselves."""

    def forget(self) -> None:
        """The line has been interrupted."""


class Tsf85:
    """Of one or two modules, the second beyond the first from the hinge."""

    begins: int | None = TSF85_START
    whole = False
    refusals = 0

    def __init__(self, config: TaxelsConfig) -> None:
        self._modules = config.rows // TSF85_ROWS
        self._period_ms = round(config.report_s * 1e3)
        self._found: dict[int, bytes] = {}

    def size(self, head: Head) -> int | None:
        """By the length in the header; 0 as soon as the fields there cannot be a frame's."""
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

    def is_sound(self, frame: bytes) -> bool:  # noqa: ARG002
        """As far as can be known: `size` has seen that its fields are whole."""
        return True

    def pressures(self, frame: bytes) -> Sequence[int] | None:
        """Once those of every module have come."""
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

    def opening(self) -> bytes:
        """Frames by themselves from now on."""
        return tsf85_frame(TSF85_AUTOSEND, bytes((self._period_ms,)))

    def question(self) -> bytes:
        """None is needed."""
        return b""

    def forget(self) -> None:
        """Half a set of modules is none."""
        self._found.clear()


def tsf85_frame(command: int, data: bytes) -> bytes:
    """A frame, its checksum left at 0 as in the maker's programs. Raises ValueError for more than 255 bytes of data."""
    if len(data) > 0xFF:
        raise ValueError(f"a frame has at most 255 bytes of data, not {len(data)}")
    return bytes((TSF85_START, 0, command, len(data))) + data


def tsf85_field(kind: int, module: int, data: bytes) -> bytes:
    """A field with its type byte."""
    return bytes((kind | module << 2,)) + data


class St0001:
    """On its own line, asked for every frame."""

    begins: int | None = ST0001_ADDRESS
    whole = False
    refusals = 0

    def __init__(self, config: TaxelsConfig) -> None:
        """Nothing of it is needed."""

    def size(self, head: Head) -> int | None:
        """Of an answer, by its function."""
        if len(head) < 2:
            return None
        if head[1] == READ_PRESSURES:
            if len(head) < 4:
                return None
            return 4 + 2 * ST0001_TAXELS + 2 if int.from_bytes(head[2:4], "little") == 2 * ST0001_TAXELS else 0
        if head[1] == WRITE_REGISTER:
            return 8
        return 5 if head[1] in (READ_PRESSURES | EXCEPTION, WRITE_REGISTER | EXCEPTION) else 0

    def is_sound(self, frame: bytes) -> bool:
        """By its CRC."""
        return modbus_crc(frame[:-2]) == int.from_bytes(frame[-2:], "little")

    def pressures(self, frame: bytes) -> Sequence[int] | None:
        """Of an answer to the question; other answers hold none."""
        self.refusals += bool(frame[1] & EXCEPTION)
        if frame[1] != READ_PRESSURES:
            return None
        return np.frombuffer(frame[4:-2], "<u2").tolist()  # type: ignore[no-any-return]

    def opening(self) -> bytes:
        """Asks for values in millinewtons."""
        return modbus_frame(WRITE_REGISTER, VALUE_TYPE.to_bytes(2, "big") + MILLINEWTONS.to_bytes(2, "big"))

    def question(self) -> bytes:
        """For all pressures."""
        return modbus_frame(READ_PRESSURES, b"")

    def forget(self) -> None:
        """Nothing is kept."""


def modbus_crc(data: bytes) -> int:
    """CRC-16/MODBUS: polynomial 8005 reflected, begun at FFFF."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _MODBUS[(crc ^ byte) & 0xFF]
    return crc


def _modbus_entry(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ 0xA001 if byte & 1 else byte >> 1
    return byte


_MODBUS = tuple(map(_modbus_entry, range(256)))


def modbus_frame(function: int, data: bytes, address: int = ST0001_ADDRESS) -> bytes:
    """A request or an answer with its CRC."""
    body = bytes((address, function)) + data
    return body + modbus_crc(body).to_bytes(2, "little")


class TextLines:
    """Lines of numbers; what else is written is discarded, and so is the first line, which may have begun earlier."""

    begins: int | None = None
    whole = True
    refusals = 0

    def __init__(self, config: TaxelsConfig) -> None:
        self._count = config.rows * config.columns
        self._longest = self._count * (MOST_DIGITS + 2) + 2
        self._cut = True

    def size(self, head: Head) -> int | None:
        """Up to the end of the line; without one of a possible length, none begins here."""
        end = head.find(b"\n", 0, self._longest)
        if end >= 0:
            return end + 1
        return None if len(head) < self._longest else 0

    def is_sound(self, frame: bytes) -> bool:
        """As many numbers as there are taxels, the line seen from its beginning."""
        cut, self._cut = self._cut, False
        return not cut and _NUMBERS.fullmatch(frame) is not None and len(re.findall(rb"\d+", frame)) == self._count

    def pressures(self, frame: bytes) -> Sequence[int] | None:
        """Every number of the line."""
        return [int(number) for number in re.findall(rb"\d+", frame)]

    def opening(self) -> bytes:
        """Lines come by themselves."""
        return b""

    def question(self) -> bytes:
        """None is needed."""
        return b""

    def forget(self) -> None:
        """The next line may be cut."""
        self._cut = True


PROTOCOLS: Mapping[str, type[Tsf85 | St0001 | TextLines]] = {"tsf85": Tsf85, "st0001": St0001, "text": TextLines}


def make_protocol(config: TaxelsConfig) -> TaxelProtocol:
    """The configured protocol."""
    return PROTOCOLS[config.protocol](config)


class AxisPlaces:
    """Where along one axis a contact lies whose pressures sum up to so much in each row: by their centroid.

    The profile is cut at the array's ends, which draws the centroid inwards; for a logistic profile of the configured
    width that is undone. What the grid itself makes of a centroid is not, for it depends on the profile's true shape.
    """

    def __init__(self, count: int, config: TaxelsConfig) -> None:
        """Of an axis with so many rows."""
        pitch_mm, scale_mm = config.pitch_mm, config.profile_scale_mm
        self._rows_mm = np.arange(count) * pitch_mm
        self._window_mm = WINDOW_SIGMAS * config.contact_width_mm + 0.5 * pitch_mm
        edges = np.linspace(-0.5, count - 0.5, count * _CELL_STEPS + 1) * pitch_mm
        middles = 0.5 * (edges[1:] + edges[:-1])
        shares = np.diff(_logistic((edges[None, :] - middles[:, None]) / scale_mm), axis=1)
        seen = shares @ middles / shares.sum(axis=1)
        sound = np.gradient(seen, middles) >= LEAST_SLOPE
        self._seen, self._true = seen[sound], middles[sound]

    def place_mm(self, sums: FloatArray, total: float) -> float | None:
        """From the middle of the first row (mm); None for several contacts, and for one too near to an end."""
        rows = self._rows_mm
        near = np.abs(rows - float(sums @ rows) / total) <= self._window_mm
        part = float(sums[near].sum())
        if part < LEAST_SHARE * total:
            return None
        seen = float(sums[near] @ rows[near]) / part
        if not self._seen[0] <= seen <= self._seen[-1]:
            return None
        return float(np.interp(seen, self._seen, self._true))


def _logistic(x: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))


class TaxelDecoder:
    """Turns an array's bytes into reports; garbage is counted and nothing else."""

    def __init__(self, config: TaxelsConfig) -> None:
        """The configuration's baud rate dates the bytes."""
        self.counters = TaxelCounters()
        self.protocol = protocol = make_protocol(config)
        self._scanner = FrameScanner(
            config.line_baud, protocol.size, protocol.is_sound, begins=protocol.begins, whole=protocol.whole,
            counters=self.counters,
        )  # fmt: skip
        self._along = AxisPlaces(config.rows, config)
        self._config = config
        self._touched = False

    @property
    def pending(self) -> int:
        """How many bytes of an incomplete frame are in hand."""
        return self._scanner.pending

    def feed(self, data: bytes, t_recv: float) -> list[TaxelReport]:
        """Take the bytes read at `t_recv` (s, monotonic) and return the reports they complete."""
        frames = self._scanner.feed(data, t_recv)
        found = [(t, counts) for t, raw in frames if (counts := self.protocol.pressures(raw)) is not None]
        batched = len(found) > 1
        self.counters.batches += batched
        self.counters.batched += batched * len(found)
        self.counters.refusals = self.protocol.refusals
        return [self._report(t, t_recv, counts, batched) for t, counts in found]

    def reset(self) -> None:
        """Discard the frame in hand, for the line has been interrupted."""
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
        place_mm = self._along.place_mm(array.sum(axis=1), total) if self._touched else None
        return TaxelReport(
            t_first=t_first,
            t_recv=t_recv,
            x_counts=0 if place_mm is None else round(place_mm * UM_PER_MM),
            y_counts=0,
            pressure=round(total) if self._touched else 0,
            in_use=self._touched,
            batched=batched,
            unplaced=self._touched and place_mm is None,
            saturated=saturated,
        )
