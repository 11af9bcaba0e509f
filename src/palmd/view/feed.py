"""What a daemon and its emulated rig publish, taken in without being decoded."""

from __future__ import annotations

from palmd.bus.subscriber import Subscriber
from palmd.keys import Credentials
from palmd.payload import FRAMES
from palmd.quantities import LOG, LOOP, OBJECT, REPLAY, RIG, STATE
from palmd.topics import RIG_TOPICS, SYSTEM_TOPICS

Payload = tuple[str, bytes]
"""A topic and its payload, a msgpack map as it came."""

_OF_ALL = (OBJECT, STATE, LOOP, RIG, LOG, REPLAY, *RIG_TOPICS)
_OF_EACH = [(own.estimate, own.shape, own.contact, own.motion, own.info) for own in SYSTEM_TOPICS.values()]
TOPICS = tuple(topic.name for topics in (_OF_ALL, *_OF_EACH) for topic in topics)
"""What the page shows; the other topics are not even sent to us."""

QUEUED_MESSAGES = 1000  # two seconds' worth, should we be held up
MESSAGE_BYTES_MAX = 1 << 20


class Feed:
    """Listens to a daemon and perhaps to its emulated rig, and remembers the last message of each topic."""

    def __init__(self, publish: str, truth: str = "", key: Credentials | None = None) -> None:
        """`publish` and `truth` (empty for none) are ZeroMQ addresses, `key` is for the former alone.

        Raises CliError for what is no address.
        """
        self.latest: dict[str, bytes] = {}
        self._subscriber = Subscriber(
            publish,
            topics=TOPICS,
            key=key,
            keyless=[truth] if truth else [],
            high_water=QUEUED_MESSAGES,
            bytes_most=MESSAGE_BYTES_MAX,
        )

    def take(self) -> list[Payload]:
        """What has come since the last call, in its order; what is no message is left out."""
        came: list[Payload] = []
        for frames in self._subscriber.frames(QUEUED_MESSAGES):
            topic = frames[0].decode(errors="replace")
            if len(frames) in FRAMES and topic in TOPICS:
                came.append((topic, frames[1]))
        self.latest.update(came)
        return came

    def close(self) -> None:
        """Let go of the socket."""
        self._subscriber.close()
