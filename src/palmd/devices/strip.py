"""Codec of a force-sensing strip read by a microcontroller, both directions; its firmware is in `tools/strip/`.

A packet has twelve bytes and is sent every 10 ms while the strip is touched and every 50 ms while it is not, so that
silence is always a fault and never a lift-off:

    0, 1    A5 5A
    2       bit 0 touched, bit 1 force at full scale, bits 4 to 7 protocol version, 1
    3       a counter
    4, 5    position, 0 to 16383
    6, 7    force, 0 to 4095
    8, 9    age of the readings when the packet was sent, in 10 µs
    10, 11  CRC-16 of bytes 2 to 9 (CCITT: polynomial 1021, initial value FFFF, not reflected)

Numbers are little-endian. Everything here is pure and safe inside the 100 Hz loop.
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass

from palmd.devices.arrival import FirstByteClock
from palmd.devices.health import Counters
from palmd.devices.pad import PadReport

PACKET_BYTES = 12
SYNC = b"\xa5\x5a"
TOUCHED, SATURATED = 0x01, 0x02
VERSION = 1
POSITION_MAX, FORCE_MAX, AGE_MAX = 16383, 4095, 0xFFFF
AGE_UNIT_S = 1e-5
TOUCHED_S, UNTOUCHED_S = 0.010, 0.050
"""Periods of the packets (s)."""

_BODY = struct.Struct("<BBHHH")


@dataclass(frozen=True, slots=True)
class StripPacket(PadReport):
    """One packet; `t_first` is the time of its readings (s)."""

    sequence: int
    saturated: bool


@dataclass(slots=True)
class StripCounters(Counters):
    """Counters of a strip's line. `bytes == 12 * packets + discarded + bytes pending` at all times.

    `crc_errors` counts packets with a wrong checksum, `lost` packets missing according to the sequence counter,
    `strange` valid ones of another version, `batches` reads with several packets, `batched` the packets in them,
    `out_of_range` positions that are not on the strip.
    """

    bytes: int = 0
    packets: int = 0
    discarded: int = 0
    crc_errors: int = 0
    lost: int = 0
    strange: int = 0
    batches: int = 0
    batched: int = 0
    out_of_range: int = 0


def checksum(body: bytes) -> int:
    """CRC-16 (CCITT) of the bytes between sync and checksum."""
    return binascii.crc_hqx(body, 0xFFFF)


def encode(
    position: int, force: int, sequence: int, *, touched: bool = True, saturated: bool = False, age_s: float = 0.0
) -> bytes:
    """Return the twelve bytes of a packet. Raises ValueError if a number does not fit its field."""
    age = round(age_s / AGE_UNIT_S)
    for name, value, maximum in (
        ("position", position, POSITION_MAX),
        ("force", force, FORCE_MAX),
        ("sequence", sequence, 0xFF),
        ("age", age, AGE_MAX),
    ):
        if not 0 <= value <= maximum:
            raise ValueError(f"{name} must be 0 to {maximum}, not {value}")
    flags = VERSION << 4 | touched * TOUCHED | saturated * SATURATED
    body = _BODY.pack(flags, sequence, position, force, age)
    return SYNC + body + struct.pack("<H", checksum(body))


class StripDecoder:
    """Decodes a strip's bytes into packets; garbage is only counted."""

    def __init__(self, baud: int) -> None:
        """Raises ValueError if `baud` (bit/s, used for timestamps) is not positive."""
        self.counters = StripCounters()
        self._clock = FirstByteClock(baud)
        self._bytes = bytearray()
        self._sequence: int | None = None

    @property
    def pending(self) -> int:
        """Number of buffered bytes (0 to 11)."""
        return len(self._bytes)

    def feed(self, data: bytes, t_recv: float) -> list[StripPacket]:
        """Process the bytes read at `t_recv` (s, monotonic) and return the packets that they complete."""
        counters, buffer = self.counters, self._bytes
        counters.bytes += len(data)
        buffer += data
        found: list[tuple[float, bytes]] = []
        while len(buffer) >= PACKET_BYTES:
            start = buffer.find(SYNC)
            if start != 0:
                self._drop(start if start > 0 else len(buffer) - buffer.endswith(SYNC[:1]))
                continue
            body = bytes(buffer[2:10])
            if int.from_bytes(buffer[10:12], "little") != checksum(body):
                counters.crc_errors += 1
                self._drop(1)
                continue
            self._clock.begin(t_recv, len(buffer) - 1)
            found.append((self._clock.end(), body))
            counters.packets += 1
            del buffer[:PACKET_BYTES]
        batched = len(found) > 1
        counters.batches += batched
        counters.batched += batched * len(found)
        packets = [self._packet(body, t_first, t_recv, batched) for t_first, body in found]
        return [packet for packet in packets if packet is not None]

    def reset(self) -> None:
        """Discard the incomplete packet after an interruption of the line."""
        self._drop(len(self._bytes))
        self._sequence = None

    def _drop(self, count: int) -> None:
        self.counters.discarded += count
        del self._bytes[:count]

    def _packet(self, body: bytes, t_first: float, t_recv: float, batched: bool) -> StripPacket | None:
        flags, sequence, position, force, age = _BODY.unpack(body)
        if flags >> 4 != VERSION or position > POSITION_MAX or force > FORCE_MAX:
            self.counters.strange += 1
            return None
        if self._sequence is not None:
            self.counters.lost += (sequence - self._sequence - 1) % 256
        self._sequence = sequence
        return StripPacket(
            t_first=t_first - age * AGE_UNIT_S,
            t_recv=t_recv,
            x_counts=position,
            y_counts=0,
            pressure=force,
            in_use=bool(flags & TOUCHED),
            batched=batched,
            sequence=sequence,
            saturated=bool(flags & SATURATED),
        )
