"""The server's links to the daemon: its messages, which are not decoded, and the commands of all pages; never block."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from palmd.bus.command_client import CommandClient
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


TIMEOUT_S = 2.0

LEASE_S = 5.0
"""Duration of the lease of each page; an open page renews it once a second."""


@dataclass(frozen=True, slots=True)
class CommandAnswer:
    """The answer to command `number`; `error` is None if it was executed."""

    number: int
    error: str | None


class PageCommands:
    """Sends commands only to a connected daemon: none may wait in a queue and move the arm later."""

    def __init__(self, address: str, key: Credentials | None = None) -> None:
        """Raises CliError for an invalid ZeroMQ address."""
        self._deadlines: dict[int, float] = {}
        self._client = CommandClient(address, key=key, now_or_never=True)

    @property
    def open(self) -> bool:
        """Whether a daemon accepts commands at the address."""
        return self._client.open

    def send(self, command: str, args: Mapping[str, str | int | float], t: float, client: str) -> int | None:
        """Send a command of the page `client`; returns its number for the answer, None without a daemon. t in s."""
        number = self._client.post(command, args, client, LEASE_S)
        if number is not None:
            self._deadlines[number] = t + TIMEOUT_S
        return number

    def answers(self, t: float) -> list[CommandAnswer]:
        """The answers received by t (s), and errors for those that are overdue."""
        found: list[CommandAnswer] = []
        for reply in self._client.replies():
            number = reply["id"]
            if self._deadlines.pop(number, None) is not None:
                error = None if reply.get("ok") is True else str(reply.get("error", "refused"))
                found.append(CommandAnswer(number, error))
        for number in [number for number, deadline in self._deadlines.items() if deadline < t]:
            del self._deadlines[number]
            found.append(CommandAnswer(number, f"no answer from {self._client.address} within {TIMEOUT_S:g} s"))
        return found

    def close(self) -> None:
        """Close the socket and discard unsent commands."""
        self._client.close()
