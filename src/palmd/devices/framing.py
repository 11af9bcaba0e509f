"""Find frames in a byte stream that may contain garbage, timestamp them, and count every byte. Pure, safe in the loop.

The codec defines the frame format by two functions: the size of a frame that begins at the front of the buffer, and
whether the checksum and content of a complete frame are valid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from palmd.devices.arrival import FirstByteClock
from palmd.devices.health import Counters

Head = bytes | bytearray
"""The buffered bytes from which a codec determines the size of a frame."""

Frame = tuple[float, bytes]
"""Arrival time (s) of a frame's first byte, and the frame's bytes."""


def crc_table(polynomial: int, bits: int, *, reflected: bool = False) -> tuple[int, ...]:
    """The table of a CRC of so many bits: what it becomes by each byte, starting from 0.

    reflected: the CRC shifts to the right, and the polynomial is given in that order.
    """
    mask, top = (1 << bits) - 1, 1 if reflected else 1 << bits - 1
    table = []
    for crc in range(256) if reflected else range(0, 256 << bits - 8, 1 << bits - 8):
        for _ in range(8):
            shifted = crc >> 1 if reflected else crc << 1 & mask
            crc = shifted ^ polynomial if crc & top else shifted
        table.append(crc)
    return tuple(table)


@dataclass(slots=True)
class FrameCounters(Counters):
    """Counters of a line; `bytes` are those of frames, the discarded ones and those pending.

    `packets` counts valid frames, `crc_errors` frames whose checksum or content is wrong, `discarded` bytes outside
    valid frames.
    """

    bytes: int = 0
    packets: int = 0
    crc_errors: int = 0
    discarded: int = 0


class FrameScanner:
    """Splits a byte stream into frames; the result does not depend on how the bytes were split among reads."""

    def __init__(
        self,
        baud: int,
        size: Callable[[Head], int | None],
        is_valid: Callable[[bytes], bool],
        *,
        first_byte: int | None = None,
        discard_whole: bool = False,
        counters: FrameCounters | None = None,
    ) -> None:
        """Raises ValueError if `baud` (bit/s, used for timestamps) is not positive.

        size: size of the frame that begins with these bytes; None: more bytes are needed, 0: no frame begins here.
        is_valid: checks a complete frame. first_byte: the byte with which every frame begins, None for any.
        discard_whole: discard an invalid frame as a whole; otherwise only its first byte, since a frame may begin
        inside.
        """
        self.counters = FrameCounters() if counters is None else counters
        self._size, self._is_valid, self._first_byte, self._discard_whole = size, is_valid, first_byte, discard_whole
        self._clock = FirstByteClock(baud)
        self._bytes = bytearray()
        self._t_read: list[tuple[int, float]] = []  # for each buffered read: its end in `_bytes`, and its time (s)

    @property
    def pending(self) -> int:
        """Number of buffered bytes."""
        return len(self._bytes)

    def feed(self, data: bytes, t_recv: float) -> list[Frame]:
        """Process the bytes read at `t_recv` (s, monotonic) and return the frames that they complete."""
        if not data:
            return []
        self.counters.bytes += len(data)
        self._bytes += data
        self._t_read.append((len(self._bytes), t_recv))
        return self._scan()

    def flush(self) -> list[Frame]:
        """Give up the incomplete frame at the front and return the frames found behind its start."""
        found: list[Frame] = []
        while self._bytes:
            self._drop(1)
            found += self._scan()
        return found

    def reset(self) -> None:
        """Discard the buffer after an interruption of the line."""
        self._drop(len(self._bytes))

    def _scan(self) -> list[Frame]:
        found: list[Frame] = []
        while (size := self._next_frame_size()) is not None:
            raw = bytes(self._bytes[:size])
            if not self._is_valid(raw):
                self.counters.crc_errors += 1
                self._drop(size if self._discard_whole else 1)
                continue
            found.append((self._t_first(), raw))
            self.counters.packets += 1
            self._take(size)
        return found

    def _next_frame_size(self) -> int | None:
        """Return the size of the complete frame at the front, None while there is none. Discards bytes before it."""
        while self._bytes:
            if self._first_byte is not None and self._bytes[0] != self._first_byte:
                start = self._bytes.find(self._first_byte)
                self._drop(len(self._bytes) if start < 0 else start)
                continue
            size = self._size(self._bytes)
            if size is None:
                return None
            if size > 0:
                return size if len(self._bytes) >= size else None
            self._drop(1)
        return None

    def _t_first(self) -> float:
        """Return the arrival time (s) of the byte at the front; see `FirstByteClock`."""
        (end, t_recv), *later = self._t_read
        self._clock.begin(t_recv, end - 1)
        for end, t_recv in later:
            self._clock.more(t_recv, end - 1)
        return self._clock.end()

    def _drop(self, count: int) -> None:
        self.counters.discarded += count
        self._take(count)

    def _take(self, count: int) -> None:
        if count:
            del self._bytes[:count]
            self._t_read = [(end - count, t) for end, t in self._t_read if end > count]
