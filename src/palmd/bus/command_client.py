"""Client of a daemon's command socket."""

from __future__ import annotations

import functools
import itertools
import math
import os
import pwd
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgpack
import zmq

from palmd.bus.link import Link, unreachable, wait_ms
from palmd.keys import Credentials
from palmd.payload import unpacked

TIMEOUT_S = 2.0


class CommandClient(Link):
    """Sends commands, and waits for the answer (`ask`) or does not wait (`post`, `replies`)."""

    def __init__(
        self,
        address: str,
        timeout_s: float = TIMEOUT_S,
        key: Credentials | None = None,
        *,
        now_or_never: bool = False,
        client: str = "",
        lease_s: float | None = None,
        key_option: str = "--key",
    ) -> None:
        """`client` identifies us to the daemon, by default this user at this terminal. `lease_s` declares how long (s)
        our control lasts after each request; without it the daemon's default lease applies.

        `now_or_never`: commands that cannot be delivered now are dropped, so that they cannot move the arm later.

        `key_option` is the name of the key option in error messages.

        Raises CliError for an invalid address.
        """
        super().__init__(zmq.DEALER)
        self._socket.setsockopt(zmq.SNDTIMEO, math.ceil(timeout_s * 1e3))  # a rejected client has no peer to send to
        self._socket.setsockopt(zmq.IMMEDIATE, int(now_or_never))
        self._key, self._timeout_s, self._key_option = key, timeout_s, key_option
        self._lease_s = lease_s
        self.client = client or own_client()
        self.address = address
        self._numbers = itertools.count(1)
        self._connect([address], key)

    def ask(self, command: str, args: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """The reply `{id, ok, error?, result?}`; raises CliError if none arrives in time."""
        number = next(self._numbers)
        t_end = time.monotonic() + self._timeout_s
        with suppress(zmq.Again):
            self._socket.send(self._request(number, command, args, self.client))
        while self._socket.poll(wait_ms(t_end)):
            reply = unpacked(self._socket.recv_multipart()[-1])
            if reply is not None and reply.get("id") == number and isinstance(reply.get("ok"), bool):
                return reply
        raise unreachable(f"no answer from {self.address} within {self._timeout_s:g} s", self._key, self._key_option)

    @property
    def open(self) -> bool:
        """Whether a daemon accepts commands at the address."""
        return bool(self._socket.poll(0, zmq.POLLOUT))

    def post(
        self, command: str, args: Mapping[str, Any] | None = None, client: str = "", lease_s: float | None = None
    ) -> int | None:
        """Send a command; returns the number of its answer, or None if it cannot be delivered.

        `client` and `lease_s` replace our own, for commands sent on behalf of others.
        """
        number = next(self._numbers)
        try:
            self._socket.send(self._request(number, command, args, client or self.client, lease_s), zmq.NOBLOCK)
        except zmq.Again:
            return None
        return number

    def replies(self) -> Iterator[dict[str, Any]]:
        """The answers that have arrived; messages that are not answers are skipped."""
        while True:
            try:
                frames = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            reply = unpacked(frames[-1])
            if reply is not None and isinstance(reply.get("id"), int):
                yield reply

    def _request(
        self, number: int, command: str, args: Mapping[str, Any] | None, client: str, lease_s: float | None = None
    ) -> bytes:
        request: dict[str, Any] = {"id": number, "cmd": command, "args": dict(args or {})}
        request |= {"from": own_name(), "client": client}
        lease_s = self._lease_s if lease_s is None else lease_s
        return bytes(msgpack.packb(request if lease_s is None else request | {"lease_s": lease_s}))


@functools.cache
def own_client() -> str:
    """Identity of this process for a daemon: the user at the terminal, so that all commands of a shell are one client.

    Without a terminal all palmd commands of the user are one client; any other program is a separate client.
    """
    terminal = _terminal()
    if not terminal and not own_name().startswith("palmd"):
        return own_name()
    return f"{_user()} on {terminal}" if terminal else f"{_user()}, no terminal"


def _terminal() -> str:
    """The controlling terminal, even if input and output are redirected; empty without one."""
    try:
        fields = Path("/proc/self/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        number = int(fields[4])
    except (OSError, ValueError, IndexError):
        return ""
    major, minor = os.major(number), os.minor(number)
    if 136 <= major <= 143:
        return f"pts/{256 * (major - 136) + minor}"
    return f"terminal {major}:{minor}" if number else ""


def _user() -> str:
    try:
        user = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        user = f"user {os.getuid()}"
    return "".join(letter if letter.isprintable() else "?" for letter in user[:30])


@functools.cache
def own_name() -> str:
    """How this program names itself: `palmd ctl of ann, process 4711`."""
    program = Path(sys.argv[0]).name or "python"
    if program in ("palmd", "__main__.py"):
        program = " ".join(["palmd", *(word for word in sys.argv[1:2] if word.isalpha())])
    name = f"{program[:40]} of {_user()}, process {os.getpid()}"
    return "".join(letter if letter.isprintable() else "?" for letter in name)
