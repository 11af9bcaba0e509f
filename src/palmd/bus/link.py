"""Common parts of all clients of a daemon's sockets: its default addresses, our key, and one socket."""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import zmq

from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError, as_cli_error
from palmd.keys import Credentials, KeysError, client_credentials

PORT_MOST = 65535
PUBLISH = "tcp://127.0.0.1:9872"
COMMAND = "tcp://127.0.0.1:9873"
"""Default addresses of a daemon."""

KEY_VARIABLE = "PALMD_KEY"
"""Environment variable with the file of our key, for daemons with keys."""


def add_key(parser: argparse.ArgumentParser) -> None:
    """Add the argument with which a client authenticates to a daemon with keys."""
    parser.add_argument(
        "--key",
        type=Path,
        default=os.environ.get(KEY_VARIABLE) or None,
        metavar="FILE",
        help=f"our secret key file, with the daemon's server.key beside it; if it has keys (default: ${KEY_VARIABLE})",
    )


def credentials(arguments: argparse.Namespace) -> Credentials | None:
    """The key given by the argument of `add_key`; raises CliError for an unusable key."""
    if arguments.key is None:
        return None
    with as_cli_error(KeysError):
        return client_credentials(arguments.key)


def unreachable(what: str, key: Credentials | None, key_option: str = "--key") -> CliError:
    """Error for a daemon that does not answer, with possible causes. `key_option`: the name of the key option."""
    question = f"does it have keys (then give {key_option})?" if key is None else "does it allow this key?"
    if "ipc://" in what:
        question = f"may this user open its socket (its group, mostly palmd), {question}"
    return CliError(RIG_FAILED, f"{what}: is a palmd running there, and {question}")


class Link:
    """One socket with its own context; with a key it connects only to daemons that know the key."""

    def __init__(self, kind: int) -> None:
        self._context = zmq.Context()
        self._socket = self._context.socket(kind)
        self._socket.setsockopt(zmq.LINGER, 0)

    def _connect(self, addresses: Sequence[str], key: Credentials | None) -> None:
        """Raises CliError for an invalid address. A key applies to connections made after it is set."""
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
        """Close the socket and drop undelivered messages."""
        self._context.destroy(linger=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def wait_ms(t_end: float) -> int:
    """Time from now until t_end (s, monotonic clock), in ms for ZeroMQ's `poll`."""
    return math.ceil(max(0.0, t_end - time.monotonic()) * 1e3)


def _reason(error: zmq.ZMQError) -> str:
    """The library's reason without the address."""
    return str(error.strerror).partition(" (addr=")[0]
