"""The service manager's notification socket; does nothing if there is none. Never blocks, never raises."""

from __future__ import annotations

import contextlib
import math
import os
import socket
from collections.abc import Mapping

FEEDS_PER_TIMEOUT = 4


class Notifier:
    """Notifies the service manager of the process's state."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        """`environment` gives the socket (NOTIFY_SOCKET) and the watchdog's time-out (WATCHDOG_USEC)."""
        self._socket: socket.socket | None = None
        self._status = ""
        self._feed_every_s = _watchdog_s(environment) / FEEDS_PER_TIMEOUT
        self._t_feed = math.inf if math.isinf(self._feed_every_s) else -math.inf
        address = environment.get("NOTIFY_SOCKET", "")
        if address.startswith(("/", "@")):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
            with contextlib.suppress(OSError):
                self._socket.connect("\0" + address[1:] if address.startswith("@") else address)

    def ready(self) -> None:
        """Report that start-up is complete."""
        self._send("READY=1")

    def status(self, text: str) -> None:
        """Set the line for `systemctl status`; sent when it changes."""
        if text != self._status:
            self._status = text
            self._send(f"STATUS={text}")

    def healthy(self, t: float) -> None:
        """The tick at `t` (s) succeeded: feed the watchdog as often as it needs."""
        if t >= self._t_feed:
            self._t_feed = t + self._feed_every_s
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the process is about to end."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, message: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.send(message.encode())


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """The watchdog's time-out (s), infinite if none is set for this process."""
    try:
        timeout_s = int(environment["WATCHDOG_USEC"]) * 1e-6
        pid = int(environment.get("WATCHDOG_PID", os.getpid()))
    except (KeyError, ValueError):
        return math.inf
    return timeout_s if pid == os.getpid() and timeout_s > 0.0 else math.inf
