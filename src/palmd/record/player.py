"""A recorded run on ZeroMQ again: the same topics, the same bytes, at the recorded pace or a multiple of it.

Nothing in a message is changed, so `timestamp`, `mono_ns`, `seq` and the third frame tell when the run was, not when
it is replayed: what a subscriber draws or stores from it lies where it belongs, beside other records of that day.
One topic more, `replay/run`, says that it is a replay.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import msgpack
import zmq

from palmd.messages import stamp
from palmd.quantities import REPLAY
from palmd.record.mcapfile import RawMessage
from palmd.record.recording import SILENT_S

SETTLE_S = 0.5
"""Before the first message: who has been waiting for a publisher knocks again several times a second."""

HIGH_WATER = 10_000  # messages kept for a subscriber that does not take them, as the daemon keeps them
_LAST_WORDS_MS = 1000
_LOOK_S = 0.05


class RepublishError(Exception):
    """An address that cannot be had; says why, and what to do."""


class RecordedPublisher:
    """A publisher of recorded messages; who does not listen in time loses some."""

    def __init__(self, address: str, frames: int = 3) -> None:
        """To a ZeroMQ address, so many `frames` a message; raises RepublishError when it cannot be had."""
        self._frames = frames
        self._t_announce, self._seq = -math.inf, -1
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self._socket.setsockopt(zmq.LINGER, _LAST_WORDS_MS)
        self._socket.setsockopt(zmq.SNDHWM, HIGH_WATER)
        try:
            self._socket.bind(address)
        except zmq.ZMQError as error:
            self.close()
            if error.errno == zmq.EADDRINUSE:
                raise RepublishError(
                    f"{address} is in use, perhaps by a running palmd: end it, or --publish to another address"
                ) from None
            raise RepublishError(f"{address} cannot be bound: {error.strerror}") from None

    def send(self, message: RawMessage) -> None:
        """Send one message as it was sent; raises RunError when it is damaged."""
        self._socket.send_multipart(frames(message)[: self._frames])

    def announce(self, path: Path, speed: float) -> None:
        """Say that what is published is a recorded run, once a second at most."""
        now = time.monotonic()
        if now >= self._t_announce:
            self._t_announce = now + 1.0 / REPLAY.rate_hz
            self._seq += 1
            said = stamp({"path": path.name, "speed": speed}, time.time(), now, self._seq)
            self._socket.send_multipart((REPLAY.frame, msgpack.packb(said), b"%.6f" % time.time())[: self._frames])

    def close(self) -> None:
        """Let go of the address once the last messages have left, or have had a second to."""
        self._context.destroy()


def frames(message: RawMessage) -> tuple[bytes, bytes, bytes]:
    """Topic, payload and ASCII Unix seconds, byte for byte as they were published; raises RunError when damaged."""
    timestamp = message.fields.get("timestamp")
    if not isinstance(timestamp, float):
        timestamp = message.publish_time_ns * 1e-9
    return message.topic.encode(), message.payload, b"%.6f" % timestamp


def offsets(messages: Iterable[RawMessage], speed: float) -> Iterator[tuple[float, RawMessage]]:
    """When (s from the first one) each message is due: at the pace of their arrival, times `speed`.

    Arrivals were told by a clock that may have been set meanwhile. Steps back therefore count as nothing, and longer
    steps ahead than a recording lasts through as that long.
    """
    due = 0.0
    before: int | None = None
    for message in messages:
        if before is not None:
            due += min(max((message.log_time_ns - before) * 1e-9, 0.0), SILENT_S) / speed
        before = message.log_time_ns
        yield due, message


def play(
    messages: Iterable[RawMessage],
    speed: float,
    send: Callable[[RawMessage], None],
    stopped: Callable[[], bool],
    at: Callable[[int], None],
) -> None:
    """Send each message when it is due, until `stopped`; `at` is told the number that have been sent."""
    start = time.monotonic()
    for number, (due, message) in enumerate(offsets(messages, speed), 1):
        pause(start + due, stopped)
        if stopped():
            return
        send(message)
        at(number)


def pause(until: float, stopped: Callable[[], bool]) -> None:
    """Sleep until a time of the monotonic clock (s), or until `stopped`."""
    while (rest := until - time.monotonic()) > 0.0 and not stopped():
        time.sleep(min(rest, _LOOK_S))
