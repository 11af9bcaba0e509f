"""Client of a running daemon: its messages, and commands to it."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from palmd.api.errors import PalmdError, as_palmd_error
from palmd.api.motion import RigJog, RigMotion
from palmd.bus.addresses import command_address, publish_address
from palmd.bus.command_client import CommandClient
from palmd.bus.link import unreachable
from palmd.bus.subscriber import Message, Subscriber
from palmd.keys import Credentials, client_credentials
from palmd.quantities import ESTIMATE

SILENT_S = 2.0
_KEY_OPTION = "connect(key=FILE)"


class Live:
    """A daemon's two sockets. Use it in a `with`, or `close` it.

    `for estimate in live:` yields the fields of `palm/estimate`, one dict per tick. Every iteration subscribes afresh,
    to messages from then on: in order, with up to 20 000 messages buffered for a slow reader.
    """

    def __init__(
        self, publish: str, command: str, key: Credentials | None, client: str = "", lease_s: float | None = None
    ) -> None:
        """Raises PalmdError for an invalid address."""
        self._publish, self._key = publish, key
        with as_palmd_error():
            self._client = CommandClient(
                command, key=key, now_or_never=True, client=client, lease_s=lease_s, key_option=_KEY_OPTION
            )

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return self.estimates()

    def estimates(self, seconds: float = math.inf) -> Iterator[dict[str, Any]]:
        """The fields of `palm/estimate`, tick by tick, for `seconds`; PalmdError if the daemon stops publishing."""
        return (message.fields for message in self.messages(ESTIMATE.name, seconds=seconds))

    def messages(self, *topics: str, seconds: float = math.inf) -> Iterator[Message]:
        """Messages of these topics (prefixes of names; none: all topics), for `seconds`.

        Raises PalmdError after two seconds without a message.
        """
        end = time.monotonic() + seconds
        with as_palmd_error(), Subscriber(self._publish, topics=topics or ("",), key=self._key) as subscriber:
            ever_received = False
            while (now := time.monotonic()) < end:
                received = False
                for message in subscriber.until(min(now + SILENT_S, end)):
                    received = ever_received = True
                    yield message
                if not received and (not ever_received or now + SILENT_S <= end):
                    raise unreachable(f"no message from {self._publish}", self._key, _KEY_OPTION)

    def command(self, name: str, **arguments: Any) -> dict[str, Any]:
        """Send a command and return its result: `arm`, `start`, `hold`, `stop`, `reset`, `plan`, `jog`…

        `take=True` takes control from the client that has it. `alive` renews a declared lease. Raises PalmdError with
        the reason if the command is refused or not answered.
        """
        with as_palmd_error():
            reply = self._client.ask(name, arguments)
        if not reply["ok"]:
            error = str(reply.get("error", "refused"))
            raise PalmdError(error if error.startswith(name) else f"{name}: {error}")
        result: dict[str, Any] = reply.get("result") or {}
        return result

    def move(self, duration_s: float = 2.0, **to: float) -> RigMotion:
        """Move joints, each given by its name with `_deg`, with minimum jerk, within a `with` block."""
        return RigMotion(self, "move", {"move": to, "duration_s": duration_s})

    def explore(self, coverage: float = 0.95, time_limit_s: float = 60.0) -> RigMotion:
        """Explore until the given coverage of the reachable outline, within a `with` block."""
        return RigMotion(self, "explore", {"explore": {"coverage": coverage, "time_limit_s": time_limit_s}})

    def jog(self) -> RigJog:
        """Turn palms by small steps within a `with` block, by the `turn` of the object it yields."""
        return RigJog(self)

    @property
    def client(self) -> CommandClient:
        """The client of the command socket."""
        return self._client

    def status(self) -> dict[str, Any]:
        """State, faults and plan."""
        return self.command("status")

    def close(self) -> None:
        """Close the connection; the daemon continues."""
        self._client.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
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

    `key`: the file of our secret key, for a daemon with keys. `client`: identifies us to the daemon, by default this
    user at this terminal; one client at a time has control. `lease_s`: declares how long (s, 60 at most) our control
    lasts after each command; if it runs out while the palms move, they are held. Returns at once, whether or not a
    daemon is running: the first command or iteration shows it. Raises PalmdError for an unusable address or key.
    """
    with as_palmd_error():
        credentials = None if key is None else client_credentials(Path(key))
    return Live(publish_address(publish), command_address(command), credentials, client, lease_s)
