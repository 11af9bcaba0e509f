"""Codec of the VersaPad's serial protocol, both directions.

A packet has six bytes and is sent while the pad is touched:

    0      1 1 L R T A 0 0     left, right, tap, in use
    1, 2   x, low and high six bits of a 12-bit two's complement number
    3, 4   y, likewise
    5      pressure, 0 to 127

Only a first byte has its top two bits set, so every header byte starts a packet, and one lost byte costs at most
one packet. Everything here is pure and safe inside the 100 Hz loop.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

from palmd.devices.arrival import FirstByteClock, byte_time
from palmd.devices.health import Counters
from palmd.devices.pad import PadReport

PACKET_BYTES = 6
HEADER_MASK, HEADER = 0xC3, 0xC0
LEFT, RIGHT, TAP, IN_USE = 0x20, 0x10, 0x08, 0x04
BYTE_LIMITS = (0x100, 0x40, 0x40, 0x40, 0x40, 0x80)
"""Exclusive upper limit of each byte of a packet; the first must also be a header."""

COUNT_MIN, COUNT_MAX = -2048, 2047
PRESSURE_MAX = 127

FOREIGN_LIMIT = 7
"""Limit of Page's CUSUM test for bytes of another device: a running sum of `_FOREIGN_SCORE`, not below zero and reset
by every packet. Noise reaches it within two packets, seldom more than three; a pad with a fifth of its bytes
damaged reaches it once in minutes.
"""

STALE_S = 0.032
"""Time (s, plus four byte times) after its last byte at which an incomplete packet is considered truncated.

Four byte times would suffice on a plain RS232 port, but a USB adapter delivers every 16 ms and splits packets
anywhere. Headers resynchronise the decoder, so the limit only has to prevent that the head of one packet is completed
by the tail of a much later one; two adapter periods do that and lose no valid packet.
"""


@dataclass(frozen=True, slots=True)
class PressureFormat:
    """Location of the pressure in a packet: `(raw[byte] & mask) >> shift`, subtracted from full scale if `invert`.

    Raises ValueError if no valid packet can carry such a field.
    """

    byte: int = 5
    mask: int = 0x7F
    shift: int = 0
    invert: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.byte < PACKET_BYTES:
            raise ValueError(f"pressure byte must be 1 to {PACKET_BYTES - 1}, not {self.byte}")
        if not 0 < self.mask < BYTE_LIMITS[self.byte]:
            limit = BYTE_LIMITS[self.byte] - 1
            raise ValueError(f"pressure mask of byte {self.byte} must be 1 to {limit}, not {self.mask}")
        if self.shift < 0 or self.full_scale == 0:
            raise ValueError(f"pressure shift {self.shift} leaves nothing of mask {self.mask:#04x}")

    @property
    def full_scale(self) -> int:
        """Largest pressure of this format."""
        return self.mask >> self.shift

    def decode(self, raw: bytes) -> int:
        """Return the pressure (0 to full scale) in the six bytes of a packet."""
        value = (raw[self.byte] & self.mask) >> self.shift
        return self.full_scale - value if self.invert else value

    def encode(self, pressure: int) -> int:
        """Return the bits that carry `pressure` (0 to full scale). Raises ValueError outside that range."""
        if not 0 <= pressure <= self.full_scale:
            raise ValueError(f"pressure must be 0 to {self.full_scale}, not {pressure}")
        value = self.full_scale - pressure if self.invert else pressure
        return (value << self.shift) & self.mask


@dataclass(frozen=True, slots=True)
class PadPacket(PadReport):
    """One packet as sent by the pad, including its buttons."""

    left: bool
    right: bool
    tap: bool


@dataclass(slots=True)
class PadCounters(Counters):
    """Counters of a pad's line. `bytes == 6 * packets + discarded + bytes pending` at all times.

    `bad_header`, `bad_data` and `truncated` count discarded bytes by cause: outside a packet; in a packet
    with an illegal byte, that byte included; in a packet truncated by the next header, a gap or a reset.
    `batches` counts reads with several packets, `out_of_range` packets whose position is not on the pad, `gaps`
    packets truncated because their rest did not arrive in time.
    """

    bytes: int = 0
    packets: int = 0
    bad_header: int = 0
    bad_data: int = 0
    truncated: int = 0
    batches: int = 0
    out_of_range: int = 0
    gaps: int = 0

    @property
    def discarded(self) -> int:
        """All bytes that are not part of a packet."""
        return self.bad_header + self.bad_data + self.truncated

    @property
    def batched(self) -> int:
        """Packets that came in one read with others, two or more in each: a lower bound."""
        return 2 * self.batches

    def as_dict(self) -> dict[str, int]:
        """Return all counters by name, the discarded bytes included."""
        return {**asdict(self), "bytes_discarded": self.discarded}


def is_header(byte: int) -> bool:
    """Whether `byte` can only be the first of a packet."""
    return byte & HEADER_MASK == HEADER


_FOREIGN_SCORE = tuple(-1 if is_header(byte) or byte < 0x40 else 1 if byte < 0x80 else 2 for byte in range(0x100))
"""CUSUM score of a byte: a pad's bytes are headers or below 0x40, one per packet may be up to 0x7F, none above."""


class VersaPadDecoder:
    """Decodes a pad's bytes into packets; garbage is only counted."""

    def __init__(self, baud: int, pressure: PressureFormat | None = None) -> None:
        """Raises ValueError if `baud` (bit/s, used for timestamps) is not positive."""
        self.counters = PadCounters()
        self._pressure = pressure or PressureFormat()
        self._byte_s = byte_time(baud)
        self._stale_s = STALE_S + 4 * self._byte_s
        self._clock = FirstByteClock(baud)
        self._partial = bytearray()
        self._t_last = 0.0
        self._foreign_score = 0

    @property
    def foreign(self) -> bool:
        """Whether the bytes since the last packet cannot be a pad's, not even a damaged one's."""
        return self._foreign_score >= FOREIGN_LIMIT

    @property
    def pending(self) -> int:
        """Number of buffered bytes of an incomplete packet (0 to 5)."""
        return len(self._partial)

    def feed(self, data: bytes, t_recv: float) -> list[PadPacket]:
        """Process the bytes read at `t_recv` (s, monotonic) and return the packets that they complete."""
        if not data:
            return []
        counters, partial, size = self.counters, self._partial, len(data)
        counters.bytes += size
        if partial:
            if t_recv - (size - 1) * self._byte_s - self._t_last > self._stale_s:
                self._truncate()
                counters.gaps += 1
            else:
                self._clock.more(t_recv, len(partial) + size - 1)
        self._t_last = t_recv

        found: list[tuple[float, bytes]] = []
        score = self._foreign_score
        for position, byte in enumerate(data):
            score = max(0, score + _FOREIGN_SCORE[byte])
            if is_header(byte):
                self._truncate()
                partial.append(byte)
                self._clock.begin(t_recv, size - 1 - position)
            elif not partial:
                counters.bad_header += 1
            elif byte >= BYTE_LIMITS[len(partial)]:
                counters.bad_data += len(partial) + 1
                partial.clear()
            else:
                partial.append(byte)
                if len(partial) == PACKET_BYTES:
                    found.append((self._clock.end(), bytes(partial)))
                    partial.clear()
                    score = 0

        self._foreign_score = score
        batched = len(found) > 1
        counters.packets += len(found)
        counters.batches += batched
        return [self._packet(raw, t_first, t_recv, batched) for t_first, raw in found]

    def reset(self) -> None:
        """Discard the incomplete packet after an interruption of the line."""
        self._truncate()
        self._foreign_score = 0

    def _truncate(self) -> None:
        self.counters.truncated += len(self._partial)
        self._partial.clear()

    def _packet(self, raw: bytes, t_first: float, t_recv: float, batched: bool) -> PadPacket:
        flags = raw[0]
        return PadPacket(
            t_first=t_first,
            t_recv=t_recv,
            x_counts=_signed(raw[1], raw[2]),
            y_counts=_signed(raw[3], raw[4]),
            pressure=self._pressure.decode(raw),
            in_use=bool(flags & IN_USE),
            left=bool(flags & LEFT),
            right=bool(flags & RIGHT),
            tap=bool(flags & TAP),
            batched=batched,
        )


def _signed(low: int, high: int) -> int:
    value = low | high << 6
    return value - 0x1000 if value & 0x800 else value


def encode_packet(
    x_counts: int,
    y_counts: int,
    pressure: int,
    *,
    in_use: bool = True,
    left: bool = False,
    right: bool = False,
    tap: bool = False,
    pressure_format: PressureFormat | None = None,
) -> bytes:
    """Return the six bytes of a packet; counts in -2048 to 2047.

    Raises ValueError if a number does not fit its field.
    """
    for name, counts in (("x_counts", x_counts), ("y_counts", y_counts)):
        if not COUNT_MIN <= counts <= COUNT_MAX:
            raise ValueError(f"{name} must be {COUNT_MIN} to {COUNT_MAX}, not {counts}")
    pressure_format = pressure_format or PressureFormat()
    flags = HEADER | left * LEFT | right * RIGHT | tap * TAP | in_use * IN_USE
    raw = bytearray((flags, x_counts & 0x3F, x_counts >> 6 & 0x3F, y_counts & 0x3F, y_counts >> 6 & 0x3F, 0))
    field = pressure_format.encode(pressure)
    raw[pressure_format.byte] = raw[pressure_format.byte] & ~pressure_format.mask | field
    return bytes(raw)
