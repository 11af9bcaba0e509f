"""What a daemon and its emulated rig publish, taken in without being decoded."""

from __future__ import annotations

import zmq

from palmd.keys import Credentials
from palmd.quantities import CONTACT, ESTIMATE, INFO, LOOP, MOTION, OBJECT, RIG_TOPICS, SHAPE, STATE
from palmd.view.errors import ViewError

Message = tuple[str, bytes]
"""A topic and its payload, a msgpack map as it came."""

TOPICS = tuple(topic.name for topic in (ESTIMATE, SHAPE, OBJECT, CONTACT, MOTION, STATE, LOOP, INFO, *RIG_TOPICS))
"""What the page shows; the other topics are not even sent to us."""

QUEUED_MESSAGES = 1000  # two seconds' worth, should we be held up
MESSAGE_BYTES_MAX = 1 << 20


class Feed:
    """Listens to a daemon and perhaps to its emulated rig, and remembers the last message of each topic."""

    def __init__(self, publish: str, truth: str = "", key: Credentials | None = None) -> None:
        """`publish` and `truth` (empty for none) are ZeroMQ addresses, `key` is for the former alone.

        Raises ViewError for what is no address.
        """
        self.latest: dict[str, bytes] = {}
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.RCVHWM, QUEUED_MESSAGES)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MESSAGE_BYTES_MAX)
        for topic in TOPICS:
            self._socket.subscribe(topic)
        if truth:
            self._connect(truth)  # a rig has no keys, and a key counts for what is connected after it is set
        if key is not None:
            key.encrypt(self._socket)
        self._connect(publish)

    def _connect(self, address: str) -> None:
        try:
            self._socket.connect(address)
        except zmq.ZMQError as error:
            self.close()
            raise ViewError(f"{address}: not an address ({error.strerror})") from None

    def take(self) -> list[Message]:
        """What has come since the last call, in its order; what has not three frames is left out."""
        came: list[Message] = []
        while len(came) < QUEUED_MESSAGES:
            try:
                frames = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                break
            topic = frames[0].decode(errors="replace")
            if len(frames) == 3 and topic in TOPICS:
                came.append((topic, frames[1]))
        self.latest.update(came)
        return came

    def close(self) -> None:
        """Let go of the socket."""
        self._context.destroy(linger=0)
