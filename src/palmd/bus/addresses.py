"""Addresses of a daemon, read from its configuration; clients need nothing else of it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palmd.bus.link import COMMAND, PUBLISH
from palmd.console.errors import BAD_INPUT, CliError

INSTALLED = Path("/etc/palmd/palmd.yaml")


def add_config(parser: argparse.ArgumentParser) -> None:
    """Add the argument by which a command finds a daemon at other than the usual addresses."""
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help=f"the daemon's configuration, for its addresses (default: {INSTALLED} if there is one)",
    )


def publish_address(given: str | None, config: Path | None = None) -> str:
    """The address to subscribe to: the given one, else the configured one; raises CliError for an invalid file."""
    return given or _configured(config).get("publish", PUBLISH)


def command_address(given: str | None, config: Path | None = None) -> str:
    """The address for commands: the given one, else the configured one; raises CliError for an invalid file."""
    return given or _configured(config).get("command", COMMAND)


def _configured(config: Path | None) -> dict[str, str]:
    """The addresses in the given or the installed configuration, as far as it has any."""
    path = config or INSTALLED
    if config is None and not path.exists():
        return {}
    import yaml

    try:
        return _bus_of(path)
    except (OSError, ValueError, yaml.YAMLError) as error:
        if config is None:
            return {}
        raise CliError(BAD_INPUT, f"{config}: no addresses can be read from it: {_reason(error)}") from None


def _reason(error: Exception) -> str:
    """The error in one line."""
    text = error.strerror if isinstance(error, OSError) else None
    return text or " ".join(str(error).split())


def _bus_of(config: Path) -> dict[str, str]:
    """The bus addresses, read without the configuration models, whose loading (1/3 s) would delay a `stop`."""
    import yaml

    from palmd.config.addresses import from_here

    with config.open(encoding="utf-8") as stream:
        read: Any = yaml.load(stream, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    if not isinstance(read, Mapping):
        raise ValueError("it is not a configuration")
    bus = read.get("bus")
    if not isinstance(bus, Mapping):
        return {}
    return {key: from_here(bus[key]) for key in ("publish", "command") if isinstance(bus.get(key), str)}
