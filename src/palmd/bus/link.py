"""What every client of a daemon's sockets shares: where a daemon is, who we are, and one socket to it."""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import zmq

from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.keys import Credentials, KeysError, client_credentials

PORT_MOST = 65535
PUBLISH = "tcp://127.0.0.1:9872"
COMMAND = "tcp://127.0.0.1:9873"
"""Where a daemon is unless its configuration says otherwise."""

KEY_VARIABLE = "PALMD_KEY"
"""Names the file of the key with which our commands come in where a daemon has keys."""


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


def silent(what: str, key: Credentials | None, key_option: str = "--key") -> CliError:
    """Nobody answers: what may be wrong. `key_option`: how the user would name the file of a key."""
    why = f"does it have keys (then give {key_option})?" if key is None else "does it allow this key?"
    if "ipc://" in what:
        why = f"may this user open its socket (its group, mostly palmd), {why}"
    return CliError(RIG_FAILED, f"{what}: is a palmd running there, and {why}")


class Link:
    """One socket of its own context; with a key it speaks to daemons that know the key, and to nobody else."""

    def __init__(self, kind: int) -> None:
        self._context = zmq.Context()
        self._socket = self._context.socket(kind)
        self._socket.setsockopt(zmq.LINGER, 0)

    def _connect(self, addresses: Sequence[str], key: Credentials | None) -> None:
        """Raises CliError for what is no address. A key counts for what is connected after it is set."""
        if key is not None:
            key.encrypt(self._socket)
        for address in addresses:
            _, _, port = address.removeprefix("tcp://").rpartition(":")
            if address.startswith("tcp://") and port.isdecimal() and not 0 < int(port) <= PORT_MOST:
                self.close()
                raise CliError(BAD_INPUT, f"{address}: not an address (a port is 1 to {PORT_MOST})")
            try:
                self._socket.connect(address)
            except zmq.ZMQError as error:
                self.close()
                raise CliError(
                    BAD_INPUT, f"{address}: not an address ({_reason(error)}); one looks like {PUBLISH}"
                ) from None

    def close(self) -> None:
        """Let go of the socket, and of what nobody has taken."""
        self._context.destroy(linger=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def wait_ms(t_end: float) -> int:
    """From now until t_end (s, monotonic clock), as ZeroMQ's `poll` takes it."""
    return math.ceil(max(0.0, t_end - time.monotonic()) * 1e3)


def _reason(error: zmq.ZMQError) -> str:
    """What the library has against it, without the address again."""
    return str(error.strerror).partition(" (addr=")[0]
