"""A running daemon: what it says, and what it can be told to do."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from palmd.api.errors import PalmdError, as_palmd_error
from palmd.api.motion import RigJog, RigMotion
from palmd.bus.addresses import command_address, publish_address
from palmd.bus.command_client import CommandClient
from palmd.bus.link import silent
from palmd.bus.subscriber import Message, Subscriber
from palmd.keys import Credentials, client_credentials
from palmd.quantities import ESTIMATE

SILENT_S = 2.0
_KEY_OPTION = "connect(key=FILE)"


class Live:
    """A daemon's two sockets. Use it in a `with`, or `close` it.

    `for estimate in live:` gives the fields of `palm/estimate`, one dict a tick. Every iteration listens anew, to what
    comes from then on: in order, with up to 20 000 messages waiting for a slow reader.
    """

    def __init__(
        self, publish: str, command: str, key: Credentials | None, client: str = "", lease_s: float | None = None
    ) -> None:
        """Raises PalmdError for what is no address."""
        self._publish, self._key = publish, key
        with as_palmd_error():
            self._client = CommandClient(
                command, key=key, now_or_never=True, client=client, lease_s=lease_s, key_option=_KEY_OPTION
            )

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return self.estimates()

    def estimates(self, seconds: float = math.inf) -> Iterator[dict[str, Any]]:
        """The fields of `palm/estimate`, tick by tick, for so long; PalmdError when the daemon falls silent."""
        return (message.fields for message in self.messages(ESTIMATE.name, seconds=seconds))

    def messages(self, *topics: str, seconds: float = math.inf) -> Iterator[Message]:
        """Messages of these topics (beginnings of names; none: of all), for so long (s).

        Raises PalmdError after two seconds of silence.
        """
        end = time.monotonic() + seconds
        with as_palmd_error(), Subscriber(self._publish, topics=topics or ("",), key=self._key) as subscriber:
            heard_ever = False
            while (now := time.monotonic()) < end:
                heard = False
                for message in subscriber.until(min(now + SILENT_S, end)):
                    heard = heard_ever = True
                    yield message
                if not heard and (not heard_ever or now + SILENT_S <= end):
                    raise silent(f"nothing heard from {self._publish}", self._key, _KEY_OPTION)

    def command(self, name: str, **arguments: Any) -> dict[str, Any]:
        """Tell the daemon what to do, and what it answers: `arm`, `start`, `hold`, `stop`, `reset`, `plan`, `jog`…

        With `take=True` control is taken from the client that has it. `alive` renews a declared lease.
        Raises PalmdError when it refuses, with its reason, or does not answer.
        """
        with as_palmd_error():
            reply = self._client.ask(name, arguments)
        if not reply["ok"]:
            error = str(reply.get("error", "refused"))
            raise PalmdError(error if error.startswith(name) else f"{name}: {error}")
        result: dict[str, Any] = reply.get("result") or {}
        return result

    def move(self, duration_s: float = 2.0, **to: float) -> RigMotion:
        """Moves joints, each by its name with `_deg`, with minimum jerk, within the block of a `with`."""
        return RigMotion(self, "move", {"move": to, "duration_s": duration_s})

    def explore(self, coverage: float = 0.95, time_limit_s: float = 60.0) -> RigMotion:
        """Explores the outline until so much of what can be reached is touched, within the block of a `with`."""
        return RigMotion(self, "explore", {"explore": {"coverage": coverage, "time_limit_s": time_limit_s}})

    def jog(self) -> RigJog:
        """Turns palms by small steps within the block of a `with`, by the `turn` of what it gives."""
        return RigJog(self)

    @property
    def client(self) -> CommandClient:
        """The command socket's client."""
        return self._client

    def status(self) -> dict[str, Any]:
        """State, faults and plan."""
        return self.command("status")

    def close(self) -> None:
        """Let go of the daemon, which goes on with what it does."""
        self._client.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def connect(
    publish: str | None = None,
    command: str | None = None,
    key: str | os.PathLike[str] | None = None,
    *,
    client: str = "",
    lease_s: float | None = None,
) -> Live:
    """A client of the daemon at these addresses: by default those of the installed configuration, else the usual ones.

    `key`: the file of our secret key, for a daemon with keys. `client`: who the daemon takes us for, by default this
    user at this terminal; one client at a time has control. `lease_s`: declares for how long (s, 60 at most) our
    control lasts after each command; when it runs out while the palms move, they are held.
    Returns at once, whether or not a daemon is there: the first question or iteration tells. Raises PalmdError for an
    address or a key that cannot be used.
    """
    with as_palmd_error():
        credentials = None if key is None else client_credentials(Path(key))
    return Live(publish_address(publish), command_address(command), credentials, client, lease_s)
