"""The page's one client of the daemon's command socket: asks, and never waits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from palmd.bus.command_client import CommandClient
from palmd.keys import Credentials

TIMEOUT_S = 2.0

LEASE_S = 5.0
"""The lease that each page declares; while it is open it renews it once a second."""


@dataclass(frozen=True, slots=True)
class CommandAnswer:
    """What became of the command `number`; `error` is None when it was done."""

    number: int
    error: str | None


class PageCommands:
    """Sends commands only to a daemon that is there: none may lie in a queue and move the arm later."""

    def __init__(self, address: str, key: Credentials | None = None) -> None:
        """Raises CliError for what is no ZeroMQ address."""
        self._deadlines: dict[int, float] = {}
        self._client = CommandClient(address, key=key, now_or_never=True)

    @property
    def open(self) -> bool:
        """Whether somebody takes commands at the address."""
        return self._client.open

    def send(self, command: str, args: Mapping[str, str | int | float], t: float, client: str) -> int | None:
        """The number under which the answer to `command` will come, None when nobody takes it; t in s.

        `client` is the page that gives it.
        """
        number = self._client.post(command, args, client, LEASE_S)
        if number is not None:
            self._deadlines[number] = t + TIMEOUT_S
        return number

    def answers(self, t: float) -> list[CommandAnswer]:
        """What has come by t (s), and what has not come in time."""
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
        """Let go of the socket, and of what nobody has taken."""
        self._client.close()
