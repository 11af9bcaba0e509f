"""Subscriber to the messages of a daemon or an emulated rig."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import zmq

from palmd.aliases import with_standard_names
from palmd.bus.link import Link, wait_ms
from palmd.keys import Credentials
from palmd.payload import FRAMES, unpacked

QUEUED_MESSAGES = 20_000  # messages of a minute, for a slow reader
RECONNECT_MS = 20  # so that few messages of a restarted publisher are missed


@dataclass(frozen=True, slots=True)
class Message:
    """A received message under standard names; t_recv on the monotonic clock (s)."""

    topic: str
    fields: dict[str, Any]
    t_recv: float


class Subscriber(Link):
    """Subscribes to one or more publishers; skips invalid messages."""

    def __init__(
        self,
        *addresses: str,
        topics: Sequence[str],
        key: Credentials | None = None,
        keyless: Sequence[str] = (),
        high_water: int = QUEUED_MESSAGES,
        bytes_most: int = -1,
    ) -> None:
        """`topics` are prefixes of topic names; `keyless` are addresses without keys, such as an emulated rig's.

        `high_water` messages may wait to be read, 0: unlimited; messages larger than `bytes_most` are not received.
        Raises CliError for an invalid address.
        """
        super().__init__(zmq.SUB)
        self._socket.setsockopt(zmq.RCVHWM, high_water)
        self._socket.setsockopt(zmq.MAXMSGSIZE, bytes_most)
        self._socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        for topic in topics:
            self._socket.subscribe(topic)
        self._connect(keyless, None)
        self._connect(addresses, key)

    def until(self, t_end: float) -> Iterator[Message]:
        """Messages that arrive until t_end (s, monotonic clock)."""
        t = -math.inf
        while t < t_end and self._socket.poll(wait_ms(t_end)):
            t = time.monotonic()
            frames = self._socket.recv_multipart()
            fields = unpacked(frames[1]) if len(frames) in FRAMES else None
            if fields is not None:
                topic = frames[0].decode(errors="replace")
                yield Message(topic, with_standard_names(topic, fields), t)

    def frames(self, most: int, wait_s: float = 0.0) -> Iterator[list[bytes]]:
        """Up to `most` waiting messages, not decoded; if there is none, the first that arrives within wait_s."""
        if wait_s > 0.0 and not self._socket.poll(round(wait_s * 1e3)):
            return
        for _ in range(most):
            try:
                yield self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
