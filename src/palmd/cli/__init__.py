"""The `palmd` command: `cli.table` says which module does what; it is imported when it is called."""

from __future__ import annotations

import argparse
import io
import logging
import os
import sys
from collections.abc import Mapping, Sequence
from types import ModuleType

from palmd import __version__, blas
from palmd.cli.table import Command, below, loaded, parser_of, said
from palmd.console import output
from palmd.console.arguments import Parser, one_of
from palmd.console.errors import BAD_INPUT, USAGE, CliError
from palmd.logformat import formatter

INTERRUPTED = 128 + 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 success, 1 wrong input, 2 usage, 3 the rig failed.

    Raises SystemExit for usage, help and version, as argparse does.
    """
    blas.one_thread_from_here()
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # it reads the metadata of every package to find them
    output.take_over()
    _take_any_terminal()
    try:
        module, arguments = _asked_for(argv)
        _start_logging()
        status: int = module.run(arguments)
    except CliError as error:
        print(error, file=sys.stderr)
        status = error.status
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:  # whoever read our output has seen enough
        return 0
    except OSError as error:
        if error.errno not in output.LOST:
            raise
        print(f"{error.filename or 'an output'}: cannot be written: {error.strerror}", file=sys.stderr)
        status = BAD_INPUT
    lost = output.lost_output()
    if lost:
        print(f"standard output: {lost}: what was to be said there is lost", file=sys.stderr)
    return status


def _asked_for(argv: Sequence[str] | None) -> tuple[ModuleType, argparse.Namespace]:
    """The module of the command that is asked for, and its arguments."""
    chosen = _parser().parse_args(argv)
    if chosen.command is None:
        _parser().print_help(sys.stderr)
        raise SystemExit(USAGE)
    command, words = below()[chosen.command], chosen.arguments
    if command.module is None:
        chosen = _group_parser(command).parse_args(words)
        command, words = below(command.name)[chosen.name], chosen.arguments
    module = loaded(command)
    return module, parser_of(command, module).parse_args(words)


def _take_any_terminal() -> None:
    """A terminal or pipe that is not UTF-8 gets a ? for what it cannot show, instead of a traceback."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _start_logging() -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])


def _listed(commands: Mapping[str, Command]) -> str:
    width = max(map(len, commands))
    return "\n".join(f"  {name:{width}}  {said(each)}" for name, each in commands.items())


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="palmd",
        description="An unknown planar object on two touchpad palms, reconstructed live.",
        epilog="commands:\n"
        + _listed(below())
        + "\n\nexit status: 0 success, 1 the input is wrong, 2 usage, 3 the rig failed",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"palmd {__version__}")
    parser.add_argument("command", metavar="COMMAND", nargs="?", type=one_of(below()), help="one of the commands below")
    parser.add_argument("arguments", metavar="…", nargs=argparse.REMAINDER, help="see: palmd COMMAND --help")
    return parser


def _group_parser(command: Command) -> argparse.ArgumentParser:
    """For a command that consists of others: which of them."""
    names = below(command.name)
    parser = Parser(
        prog=f"palmd {command.name}",
        description=command.help,
        epilog="names:\n" + _listed(names),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", type=one_of(names), help="one of the names below")
    parser.add_argument("arguments", metavar="…", nargs=argparse.REMAINDER, help=f"see: {parser.prog} NAME --help")
    return parser
