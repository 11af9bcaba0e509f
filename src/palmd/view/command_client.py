"""The page's one client of the daemon's command socket: asks, and never waits."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import msgpack
import zmq

from palmd.keys import Credentials
from palmd.view.errors import ViewError

TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of the command `number`; `error` is None when it was done."""

    number: int
    error: str | None


class Desk:
    """Sends commands only to a daemon that is there: none may lie in a queue and move the arm later."""

    def __init__(self, address: str, key: Credentials | None = None) -> None:
        """Raises ViewError for what is no ZeroMQ address."""
        self._address = address
        self._numbers = itertools.count(1)
        self._deadlines: dict[int, float] = {}
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.setsockopt(zmq.IMMEDIATE, 1)
        if key is not None:
            key.encrypt(self._socket)
        try:
            self._socket.connect(address)
        except zmq.ZMQError as error:
            self.close()
            raise ViewError(f"{address}: not an address ({error.strerror})") from None

    @property
    def open(self) -> bool:
        """Whether somebody takes commands at the address."""
        return bool(self._socket.poll(0, zmq.POLLOUT))

    def send(self, command: str, t: float) -> int | None:
        """The number under which the answer to `command` will come, None when nobody takes it; t in s."""
        number = next(self._numbers)
        try:
            self._socket.send(msgpack.packb({"id": number, "cmd": command, "args": {}}), zmq.NOBLOCK)
        except zmq.Again:
            return None
        self._deadlines[number] = t + TIMEOUT_S
        return number

    def answers(self, t: float) -> list[Answer]:
        """What has come by t (s), and what has not come in time."""
        found: list[Answer] = []
        while True:
            try:
                reply = _reply(self._socket.recv_multipart(zmq.NOBLOCK)[-1])
            except zmq.Again:
                break
            number: Any = reply.get("id")
            if self._deadlines.pop(number, None) is not None:
                found.append(Answer(number, None if reply.get("ok") is True else str(reply.get("error", "refused"))))
        for number in [number for number, deadline in self._deadlines.items() if deadline < t]:
            del self._deadlines[number]
            found.append(Answer(number, f"no answer from {self._address} within {TIMEOUT_S:g} s"))
        return found

    def close(self) -> None:
        """Let go of the socket, and of what nobody has taken."""
        self._context.destroy(linger=0)


def _reply(payload: bytes) -> dict[Any, Any]:
    try:
        reply = msgpack.unpackb(payload)
    except Exception:  # msgpack raises half a dozen kinds for bytes that are not its own
        return {}
    return reply if isinstance(reply, dict) and isinstance(reply.get("id"), int) else {}
