"""A command with commands of its own: a table of names, each a module `COMMAND_NAME` imported when it is called."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Mapping

from palmd.cli.arguments import one_of


def add_arguments(parser: argparse.ArgumentParser, table: Mapping[str, str]) -> None:
    """The name, out of a table from names to what they do; what follows is for that module itself."""
    width = max(map(len, table))
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "names:\n" + "\n".join(f"  {name:{width}}  {text}" for name, text in table.items())
    parser.add_argument("name", metavar="NAME", type=one_of(table), help="one of the names below")
    parser.add_argument("arguments", metavar="…", nargs=argparse.REMAINDER, help=f"see: {parser.prog} NAME --help")


def run(command: str, arguments: argparse.Namespace) -> int:
    """Runs the module, which has `add_arguments(parser)` and `run(arguments) -> int`; SystemExit as argparse does."""
    module = importlib.import_module(f"palmd.cli.{command}_{arguments.name}")
    parser = argparse.ArgumentParser(prog=f"palmd {command} {arguments.name}", description=module.__doc__)
    module.add_arguments(parser)
    status: int = module.run(parser.parse_args(arguments.arguments))
    return status
