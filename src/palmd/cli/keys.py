"""Creates keys for the bus, and manages the clients that may listen to a daemon (watch) or command it (operate).

DIR is the folder that the configuration names as bus.keys; changes of the list take effect at the daemon's next start.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd import keys
from palmd.console.errors import as_cli_error
from palmd.keys import PUBLIC, SERVER, KeysError, Role

RESTART = "takes effect after a restart of palmd"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("-d", type=Path, default=Path("keys"), metavar="DIR", dest="folder",
                        help="folder of the keys (default: %(default)s)")  # fmt: skip
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    new = actions.add_parser("new", help="create a pair of keys").add_subparsers(
        dest="whose", metavar="WHOSE", required=True
    )
    new.add_parser("server", parents=[common], help="for a daemon")
    client = new.add_parser("client", parents=[common], help="for a client, on the client's machine")
    client.add_argument("name", metavar="NAME", help="name of the client")
    _add_role(client, required=False, help="if DIR is a daemon's: allow the client at once")
    allow = actions.add_parser("allow", parents=[common], help="allow a client")
    allow.add_argument("file", type=Path, metavar="FILE", help="the client's public key, NAME.key")
    _add_role(allow, required=True, help="watch: listen and query the status; operate: all commands")
    revoke = actions.add_parser("revoke", parents=[common], help="remove a client")
    revoke.add_argument("name", metavar="NAME", help="name of the client")
    actions.add_parser("list", parents=[common], help="list the allowed clients")


def run(arguments: argparse.Namespace) -> int:
    """Execute one action; CliError if a file cannot be created, read or trusted."""
    with as_cli_error(KeysError):
        for line in _ACTIONS[arguments.action](arguments):
            print(line)
    return 0


def _new(arguments: argparse.Namespace) -> list[str]:
    folder: Path = arguments.folder
    if arguments.whose == "server":
        secret, public = keys.make_pair(folder, SERVER)
        return [f"{secret}: keep it here", f"{public}: give this to the clients"]
    name: str = arguments.name
    if name == SERVER:
        raise KeysError(f"a client cannot be called {SERVER}")
    secret, public = keys.make_pair(folder, name)
    if arguments.role is None:
        return [
            f"{secret}: keep it here, for --key",
            f"{public}: give this to the daemon's machine, for palmd keys allow",
        ]
    keys.allow(folder, public, arguments.role)
    return [f"{secret}: for --key", f"{name} may {arguments.role}; {RESTART}"]


def _allow(arguments: argparse.Namespace) -> list[str]:
    member = keys.allow(arguments.folder, arguments.file, arguments.role)
    return [f"{member.name} may {member.role}; {RESTART}"]


def _revoke(arguments: argparse.Namespace) -> list[str]:
    keys.revoke(arguments.folder, arguments.name)
    return [f"{arguments.name} is removed; {RESTART}"]


def _list(arguments: argparse.Namespace) -> list[str]:
    listed = keys.members(arguments.folder)
    width = max((len(member.name) for member in listed), default=0)
    lines = [f"{member.name:{width}}  {member.role:7}  {member.public.decode('ascii')}" for member in listed]
    return lines or [f"{arguments.folder}: no client is allowed; palmd keys allow NAME{PUBLIC} --role watch|operate"]


_ACTIONS = {"new": _new, "allow": _allow, "revoke": _revoke, "list": _list}


def _add_role(parser: argparse.ArgumentParser, *, required: bool, help: str) -> None:
    parser.add_argument("--role", type=Role, choices=list(Role), required=required, metavar="watch|operate", help=help)
