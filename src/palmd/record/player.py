"""Republish a recorded run on ZeroMQ: the same topics and bytes, at the recorded rate or a multiple of it.

Messages are not changed: `timestamp`, `mono_ns`, `seq` and the third frame are those of the recorded run, not of the
replay, so data that a subscriber stores align with other records of that day. The additional topic `replay/run` marks
the messages as a replay.
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
"""Wait before the first message; waiting subscribers retry to connect several times a second."""

HIGH_WATER_MARK = 10_000  # messages queued per slow subscriber, as in the daemon
_LINGER_MS = 1000
_POLL_S = 0.05


class RepublishError(Exception):
    """The publishing address cannot be bound; the text says why and what to do."""


class RecordedPublisher:
    """A publisher of recorded messages; late or slow subscribers lose some."""

    def __init__(self, address: str, frames: int = 3) -> None:
        """Bind a ZeroMQ address and send `frames` frames per message; raises RepublishError."""
        self._frames = frames
        self._t_announce, self._seq = -math.inf, -1
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self._socket.setsockopt(zmq.LINGER, _LINGER_MS)
        self._socket.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
        try:
            self._socket.bind(address)
        except zmq.ZMQError as error:
            self.close()
            if error.errno == zmq.EADDRINUSE:
                raise RepublishError(
                    f"{address} is in use, perhaps by a running palmd: stop it, or --publish to another address"
                ) from None
            raise RepublishError(f"{address} cannot be bound: {error.strerror}") from None

    def send(self, message: RawMessage) -> None:
        """Send one message unchanged; raises RunError if it is damaged."""
        self._socket.send_multipart(frames(message)[: self._frames])

    def announce(self, path: Path, speed: float) -> None:
        """Publish `replay/run`, once a second at most."""
        now = time.monotonic()
        if now >= self._t_announce:
            self._t_announce = now + 1.0 / REPLAY.rate_hz
            self._seq += 1
            fields = stamp({"path": path.name, "speed": speed}, time.time(), now, self._seq)
            self._socket.send_multipart((REPLAY.frame, msgpack.packb(fields), b"%.6f" % time.time())[: self._frames])

    def close(self) -> None:
        """Release the address after the last messages are sent, or after one second."""
        self._context.destroy()


def frames(message: RawMessage) -> tuple[bytes, bytes, bytes]:
    """Topic, payload and ASCII Unix seconds, byte for byte as published; raises RunError if damaged."""
    timestamp = message.fields.get("timestamp")
    if not isinstance(timestamp, float):
        timestamp = message.publish_time_ns * 1e-9
    return message.topic.encode(), message.payload, b"%.6f" % timestamp


def offsets(messages: Iterable[RawMessage], speed: float) -> Iterator[tuple[float, RawMessage]]:
    """Due time (s from the first) of each message: intervals of arrival divided by `speed`.

    The clock of the arrivals may have been set during the run. Backward steps therefore count as 0, and forward steps
    are limited to `SILENT_S`, the longest gap within a recording.
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
    """Send each message when it is due, until `stopped`; `at` is called with the number of messages sent."""
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
        time.sleep(min(rest, _POLL_S))
