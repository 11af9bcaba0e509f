"""A daemon's sockets from the other side: what it publishes, and what it can be asked."""

from __future__ import annotations

import argparse
import itertools
import math
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgpack
import zmq

from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.keys import Credentials, KeysError, client_credentials

PUBLISH = "tcp://127.0.0.1:9872"
COMMAND = "tcp://127.0.0.1:9873"
"""Where a daemon is unless its configuration says otherwise."""

KEY_VARIABLE = "PALMD_KEY"
"""Names the file of the key with which our commands come in where a daemon has keys."""

TIMEOUT_S = 2.0
QUEUED_MESSAGES = 20_000  # a minute's, should we be slow


def add_key(parser: argparse.ArgumentParser) -> None:
    """The argument with which a client of a guarded bus shows who it is."""
    parser.add_argument(
        "--key",
        type=Path,
        default=os.environ.get(KEY_VARIABLE) or None,
        metavar="FILE",
        help=f"our secret key, the daemon's server.key beside it; for a daemon with keys (default: ${KEY_VARIABLE})",
    )


def credentials(arguments: argparse.Namespace) -> Credentials | None:
    """What `add_key` asked for; raises CliError for a key that cannot be used."""
    if arguments.key is None:
        return None
    try:
        return client_credentials(arguments.key)
    except KeysError as error:
        raise CliError(BAD_INPUT, str(error)) from None


def silent(what: str, key: Credentials | None) -> CliError:
    """Nobody answers: what may be wrong."""
    why = "does it have keys (then give --key)?" if key is None else "does it allow this key?"
    return CliError(RIG_FAILED, f"{what}: is a palmd running there, and {why}")


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it came; t_recv on the monotonic clock (s)."""

    topic: str
    fields: dict[str, Any]
    t_recv: float


class _Link:
    """One socket of its own context; with a key it speaks to daemons that know the key, and to nobody else."""

    def __init__(self, kind: int, *addresses: str, key: Credentials | None) -> None:
        self._key = key
        self._context = zmq.Context()
        self._socket = self._context.socket(kind)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.RCVHWM, QUEUED_MESSAGES)
        if key is not None:
            key.encrypt(self._socket)
        for address in addresses:
            try:
                self._socket.connect(address)
            except zmq.ZMQError as error:
                self.close()
                raise CliError(
                    BAD_INPUT, f"{address}: not an address ({error.strerror}); it looks like {PUBLISH}"
                ) from None

    def close(self) -> None:
        """Let go of the socket."""
        self._context.destroy(linger=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class Subscriber(_Link):
    """Listens to one or more publishers; what is no message of theirs is left out."""

    def __init__(self, *addresses: str, topics: Sequence[str], key: Credentials | None = None) -> None:
        """`topics` are beginnings of topic names. Raises CliError for what is no address."""
        super().__init__(zmq.SUB, *addresses, key=key)
        for topic in topics:
            self._socket.subscribe(topic)

    def until(self, t_end: float) -> Iterator[Message]:
        """What comes until t_end (s, monotonic clock), as it comes."""
        t = -math.inf
        while t < t_end and self._socket.poll(_wait_ms(t_end)):
            t = time.monotonic()
            message = _message(self._socket.recv_multipart(), t)
            if message is not None:
                yield message


class Client(_Link):
    """Asks a command socket, and waits for the answer."""

    def __init__(self, address: str, timeout_s: float = TIMEOUT_S, key: Credentials | None = None) -> None:
        """Raises CliError for what is no address."""
        super().__init__(zmq.DEALER, address, key=key)
        self._socket.setsockopt(zmq.SNDTIMEO, math.ceil(timeout_s * 1e3))  # who is turned away has nowhere to send to
        self._address, self._timeout_s = address, timeout_s
        self._numbers = itertools.count(1)

    def ask(self, command: str, args: dict[str, Any] | None = None) -> dict[str, Any]:
        """The reply `{id, ok, error?, result?}`; raises CliError when none comes in time."""
        number = next(self._numbers)
        t_end = time.monotonic() + self._timeout_s
        with suppress(zmq.Again):
            self._socket.send(msgpack.packb({"id": number, "cmd": command, "args": args or {}}))
        while self._socket.poll(_wait_ms(t_end)):
            reply = _unpacked(self._socket.recv_multipart()[-1])
            if reply is not None and reply.get("id") == number and isinstance(reply.get("ok"), bool):
                return reply
        raise silent(f"no answer from {self._address} within {self._timeout_s:g} s", self._key)


def _wait_ms(t_end: float) -> int:
    return math.ceil(max(0.0, t_end - time.monotonic()) * 1e3)


def _message(frames: list[bytes], t_recv: float) -> Message | None:
    if len(frames) != 3:
        return None
    fields = _unpacked(frames[1])
    return None if fields is None else Message(frames[0].decode(errors="replace"), fields, t_recv)


def _unpacked(payload: bytes) -> dict[str, Any] | None:
    try:
        fields = msgpack.unpackb(payload)
    except Exception:  # msgpack raises half a dozen kinds for bytes that are not its own
        return None
    return fields if isinstance(fields, dict) else None
