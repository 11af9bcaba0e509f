"""Makes keys for the bus, and keeps the list of who may listen to a daemon (watch) or command it (operate).

DIR is the folder that the configuration names as bus.keys; a change of the list counts from the daemon's next start.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd import keys
from palmd.console.errors import BAD_INPUT, CliError
from palmd.keys import PUBLIC, SERVER, KeysError, Role

RESTART = "restart palmd for it to count"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("-d", type=Path, default=Path("keys"), metavar="DIR", dest="folder",
                        help="folder of the keys (default: %(default)s)")  # fmt: skip
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    new = actions.add_parser("new", help="make a pair of keys").add_subparsers(
        dest="whose", metavar="WHOSE", required=True
    )
    new.add_parser("server", parents=[common], help="for a daemon")
    client = new.add_parser("client", parents=[common], help="for a client, on the machine where that runs")
    client.add_argument("name", metavar="NAME", help="what it is called")
    _add_role(client, required=False, help="DIR is a daemon's: allow the client at once")
    allow = actions.add_parser("allow", parents=[common], help="let a client in")
    allow.add_argument("file", type=Path, metavar="FILE", help="its public key, NAME.key")
    _add_role(allow, required=True, help="listen and ask for the status, or give every command")
    revoke = actions.add_parser("revoke", parents=[common], help="let a client in no longer")
    revoke.add_argument("name", metavar="NAME", help="what it is called")
    actions.add_parser("list", parents=[common], help="who may come in")


def run(arguments: argparse.Namespace) -> int:
    """Does one action; CliError where a file cannot be made, read or trusted."""
    try:
        for line in _ACTIONS[arguments.action](arguments):
            print(line)
    except KeysError as error:
        raise CliError(BAD_INPUT, str(error)) from None
    return 0


def _new(arguments: argparse.Namespace) -> list[str]:
    folder: Path = arguments.folder
    if arguments.whose == "server":
        secret, public = keys.make_pair(folder, SERVER)
        return [f"{secret}: stays here", f"{public}: give this to the clients"]
    name: str = arguments.name
    if name == SERVER:
        raise KeysError(f"a client cannot be called {SERVER}")
    secret, public = keys.make_pair(folder, name)
    if arguments.role is None:
        return [
            f"{secret}: stays here, for --key",
            f"{public}: give this to the daemon's machine, for palmd keys allow",
        ]
    keys.allow(folder, public, arguments.role)
    return [f"{secret}: for --key", f"{name} may {arguments.role}; {RESTART}"]


def _allow(arguments: argparse.Namespace) -> list[str]:
    member = keys.allow(arguments.folder, arguments.file, arguments.role)
    return [f"{member.name} may {member.role}; {RESTART}"]


def _revoke(arguments: argparse.Namespace) -> list[str]:
    keys.revoke(arguments.folder, arguments.name)
    return [f"{arguments.name} may not come in any more; {RESTART}"]


def _list(arguments: argparse.Namespace) -> list[str]:
    listed = keys.members(arguments.folder)
    width = max((len(member.name) for member in listed), default=0)
    lines = [f"{member.name:{width}}  {member.role:7}  {member.public.decode('ascii')}" for member in listed]
    return lines or [f"{arguments.folder}: nobody may come in; palmd keys allow NAME{PUBLIC} --role watch|operate"]


_ACTIONS = {"new": _new, "allow": _allow, "revoke": _revoke, "list": _list}


def _add_role(parser: argparse.ArgumentParser, *, required: bool, help: str) -> None:
    parser.add_argument("--role", type=Role, choices=list(Role), required=required, metavar="watch|operate", help=help)
