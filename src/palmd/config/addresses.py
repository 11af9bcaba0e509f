"""Validators of ZeroMQ addresses in configurations."""

from __future__ import annotations

import ipaddress
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator


def _host(address: str) -> str | None:
    """The host of a TCP address, None for a local socket."""
    if address.startswith("ipc://") and len(address) > len("ipc://"):
        return None
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not address.startswith("tcp://") or not host or not port or parts.path:
        raise ValueError(f"must be tcp://ADDRESS:PORT (port 1 to 65535) or ipc://PATH; got {address!r}")
    return host


def local_address(address: str) -> str:
    """Loopback TCP or a local socket; other addresses need keys."""
    host = _host(address)
    if host not in (None, "localhost") and not ((ip := _ipv4(host)) and ip.is_loopback):
        raise ValueError(
            f"{host} can be reached from other machines, which needs CURVE keys, and none are configured;"
            " use tcp://127.0.0.1:PORT or ipc://PATH"
        )
    return address


def guarded_address(address: str) -> str:
    """Any address of this machine, for a bus with keys."""
    host = _host(address)
    if host not in (None, "localhost") and _ipv4(host) is None:
        raise ValueError(f"must be an IPv4 address of this machine, or 0.0.0.0 for all of them; got {host}")
    return address


def _ipv4(host: str | None) -> ipaddress.IPv4Address | None:
    try:
        return ipaddress.IPv4Address(host)
    except ValueError:
        return None


LocalAddress = Annotated[str, AfterValidator(local_address)]


def from_here(address: str) -> str:
    """The address to which a program on the daemon's machine connects if the daemon binds `address`."""
    return address.replace("tcp://0.0.0.0:", "tcp://127.0.0.1:")
