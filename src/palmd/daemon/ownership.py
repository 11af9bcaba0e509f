"""Which client has control of the rig, and for how long. Pure, and safe in the loop.

One client at a time has control: the last that moved, held or stopped the rig. Its control ends when it has sent
nothing for the length of its lease. A client that declares a lease promises to renew it while its operator is present:
the end of such a lease means that the operator is lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.daemon.commands import Request

LEASE_S = 5.0
"""The lease of a client that declares none."""

CLIENTS_MOST = 64
"""Number of clients whose declared leases are kept; the one silent for longest is dropped first."""

ALWAYS_OBEYED = frozenset({"hold", "stop"})
"""Commands that every client may give, and that give it control."""


@dataclass(frozen=True, slots=True)
class Client:
    """A sender of requests: `key` identifies the client, `name` is for people and never empty."""

    key: tuple[str, str, str]
    name: str


NOBODY_KEY = ("", "", "")


def client_of(request: Request) -> Client:
    """The client that sent a request: given by its `client` text, else its connection, within one CURVE key."""
    member, name = request.member, request.client
    if name:
        return Client((member, "client", name), f"{member}, {name}" if member else name)
    connection = request.route[0].hex() if request.route else ""
    program = request.who or "a program"
    return Client(
        (member, "connection", connection), f"{program} (connection {connection[-6:]})" if connection else program
    )


@dataclass(slots=True)
class _Lease:
    """Control for `length_s` after each request, at present until `t_end` (s)."""

    length_s: float
    t_end: float


class Control:
    """The client in control. Times are seconds on one clock; call `expire` before `renew` for each request."""

    def __init__(self) -> None:
        self._owner: Client | None = None
        self._t_end = -math.inf
        self._declared: dict[tuple[str, str, str], _Lease] = {}

    @property
    def name(self) -> str:
        """The name of the client in control, empty for none."""
        return self._owner.name if self._owner is not None else ""

    @property
    def key(self) -> tuple[str, str, str]:
        """The key of the client in control, `NOBODY_KEY` for none."""
        return self._owner.key if self._owner is not None else NOBODY_KEY

    @property
    def attended(self) -> bool:
        """Whether the client in control has declared a lease."""
        return self._owner is not None and self._owner.key in self._declared

    def renew(self, client: Client, t: float, lease_s: float | None = None) -> None:
        """Renew the lease of a client whose request arrived at `t` (s), with the lease that it declares, if any."""
        lease = self._declared.get(client.key)
        if lease is not None and lease_s is None and t <= lease.t_end:
            lease_s = lease.length_s
        self._declared.pop(client.key, None)
        if lease_s is not None:
            self._declared[client.key] = _Lease(lease_s, t + lease_s)
            if len(self._declared) > CLIENTS_MOST:
                self._forget_one()
        if client.key == self.key:
            self._t_end = self._until(client, t)

    def gain(self, client: Client, t: float) -> None:
        """Give the client control from `t` (s) on."""
        self._owner, self._t_end = client, self._until(client, t)

    def expire(self, t: float) -> Client | None:
        """End control if its lease has run out; returns the client if it had declared the lease."""
        owner = self._owner
        if owner is None or t <= self._t_end:
            return None
        self._owner = None
        return owner if self._declared.pop(owner.key, None) is not None else None

    def other(self, client: Client) -> Client | None:
        """The client in control if it is another one."""
        return self._owner if self._owner is not None and self._owner.key != client.key else None

    def _until(self, client: Client, t: float) -> float:
        lease = self._declared.get(client.key)
        return t + LEASE_S if lease is None else lease.t_end

    def _forget_one(self) -> None:
        """Drop the client silent for longest: the dictionary is in the order of the latest requests."""
        oldest = next(key for key in self._declared if key != self.key)
        del self._declared[oldest]
