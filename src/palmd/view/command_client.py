"""The server's client of the daemon's command socket, shared by all pages; it never blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from palmd.bus.command_client import CommandClient
from palmd.keys import Credentials

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
