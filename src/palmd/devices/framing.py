"""Frames in a line's bytes: found among garbage, dated by their first byte, every byte counted. Pure, safe in the loop.

What a frame looks like is the codec's part: how long one is that begins at the front of the bytes in hand, and whether
its checksum and content are sound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

from palmd.devices.arrival import FirstByteClock

Head = bytes | bytearray
"""The bytes in hand, from which a codec determines how long a frame is."""

Frame = tuple[float, bytes]
"""When the first byte of a frame arrived (s), and its bytes."""


@dataclass(slots=True)
class FrameCounters:
    """What a line has brought; `bytes` are those of frames, discarded ones and those pending.

    `packets` counts frames, `crc_errors` those whose checksum or content is wrong, `discarded` bytes of no frame.
    """

    bytes: int = 0
    packets: int = 0
    crc_errors: int = 0
    discarded: int = 0

    def as_dict(self) -> dict[str, int]:
        """Every count by name."""
        return asdict(self)


class FrameScanner:
    """Cuts a line's bytes into frames; the result does not depend on how the bytes were split among reads."""

    def __init__(
        self,
        baud: int,
        size: Callable[[Head], int | None],
        is_sound: Callable[[bytes], bool],
        *,
        begins: int | None = None,
        whole: bool = False,
        counters: FrameCounters | None = None,
    ) -> None:
        """`baud` in bit/s dates the bytes. Raises ValueError if it is not positive.

        size: of the frame that begins with these bytes, None where more are needed, 0 where none begins there.
        is_sound: of a whole frame. begins: the byte that every frame begins with, None where any may. whole: an unsound
        frame is discarded as a whole; otherwise only its first byte is, for a frame may lie inside.
        """
        self.counters = FrameCounters() if counters is None else counters
        self._size, self._is_sound, self._begins, self._whole = size, is_sound, begins, whole
        self._clock = FirstByteClock(baud)
        self._bytes = bytearray()
        self._t_read: list[tuple[int, float]] = []  # of each read in hand: where in `_bytes` it ends, and when

    @property
    def pending(self) -> int:
        """How many bytes are in hand."""
        return len(self._bytes)

    def feed(self, data: bytes, t_recv: float) -> list[Frame]:
        """Take the bytes read at `t_recv` (s, monotonic) and return the frames they complete."""
        if not data:
            return []
        self.counters.bytes += len(data)
        self._bytes += data
        self._t_read.append((len(self._bytes), t_recv))
        return self._found()

    def give_up(self) -> list[Frame]:
        """No more comes of the frame in hand: the frames that it hid."""
        found: list[Frame] = []
        while self._bytes:
            self._drop(1)
            found += self._found()
        return found

    def reset(self) -> None:
        """Discard what is in hand, for the line has been interrupted."""
        self._drop(len(self._bytes))

    def _found(self) -> list[Frame]:
        found: list[Frame] = []
        while (size := self._at_frame()) is not None:
            raw = bytes(self._bytes[:size])
            if not self._is_sound(raw):
                self.counters.crc_errors += 1
                self._drop(size if self._whole else 1)
                continue
            found.append((self._t_first(), raw))
            self.counters.packets += 1
            self._take(size)
        return found

    def _at_frame(self) -> int | None:
        """The size of the frame at the front, all of it there; None while it is not. Drops what cannot be one."""
        while self._bytes:
            if self._begins is not None and self._bytes[0] != self._begins:
                start = self._bytes.find(self._begins)
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
        """When the byte at the front arrived: no read can be earlier than its bytes took on the line."""
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
