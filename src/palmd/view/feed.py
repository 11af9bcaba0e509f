"""Subscription to a daemon and its emulated rig; messages are not decoded."""

from __future__ import annotations

from palmd.bus.subscriber import Subscriber
from palmd.keys import Credentials
from palmd.payload import FRAMES
from palmd.quantities import LOG, LOOP, OBJECT, REPLAY, RIG, STATE
from palmd.topics import RIG_TOPICS, SYSTEM_TOPICS

Payload = tuple[str, bytes]
"""A topic and its payload, an undecoded msgpack map."""

_OF_ALL = (OBJECT, STATE, LOOP, RIG, LOG, REPLAY, *RIG_TOPICS)
_OF_EACH = [(own.estimate, own.shape, own.contact, own.motion, own.info) for own in SYSTEM_TOPICS.values()]
TOPICS = tuple(topic.name for topics in (_OF_ALL, *_OF_EACH) for topic in topics)
"""Topics that the page shows; others are not subscribed to."""

QUEUED_MESSAGES = 1000  # about two seconds of messages
MESSAGE_BYTES_MAX = 1 << 20


class Feed:
    """Subscribes to a daemon and optionally its emulated rig, and keeps the last message of each topic."""

    def __init__(self, publish: str, truth: str = "", key: Credentials | None = None) -> None:
        """`publish` and `truth` (empty for none) are ZeroMQ addresses; `key` is for `publish` only.

        Raises CliError for an invalid address.
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
        """The messages since the last call, in order; malformed ones are dropped."""
        messages: list[Payload] = []
        for frames in self._subscriber.frames(QUEUED_MESSAGES):
            topic = frames[0].decode(errors="replace")
            if len(frames) in FRAMES and topic in TOPICS:
                messages.append((topic, frames[1]))
        self.latest.update(messages)
        return messages

    def close(self) -> None:
        """Close the socket."""
        self._subscriber.close()
