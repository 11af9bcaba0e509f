"""The `palmd` command: `cli.table` says which module does what; it is imported when it is called."""

from __future__ import annotations

import argparse
import io
import logging
import os
import sys
from collections.abc import Callable, Sequence
from types import ModuleType

from palmd import __version__, blas
from palmd.cli.table import MOVED, RENAMED, Command, below, listed, loaded, parser_of
from palmd.console import output
from palmd.console.arguments import Parser, one_of
from palmd.console.errors import BAD_INPUT, USAGE, CliError
from palmd.logformat import formatter

INTERRUPTED = 128 + 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 success, 1 wrong input, 2 usage, 3 the rig failed.

    Raises SystemExit for usage, help and version, as argparse does.
    """
    return status_of(lambda: _asked_for(argv))


def status_of(asked_for: Callable[[], tuple[ModuleType, argparse.Namespace]]) -> int:
    """Run the module with the arguments that are asked for; returns the exit status as `main` does."""
    blas.one_thread_from_here()
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # it reads the metadata of every package to find them
    output.take_over()
    _take_any_terminal()
    try:
        module, arguments = asked_for()
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
    """The module of the command that is asked for, and its arguments. Raises CliError for a command that has moved."""
    given = _with_new_names(list(sys.argv[1:] if argv is None else argv))
    chosen = _parser().parse_args(given)
    if chosen.command is None:
        _parser().print_help(sys.stderr)
        raise SystemExit(USAGE)
    command, words = below()[chosen.command], chosen.arguments
    names = below(command.name)
    if command.module is None:
        chosen = _group_parser(command).parse_args(words)
        command, words = names[chosen.name], chosen.arguments
    elif words and words[0] in names:
        command, words = names[words[0]], words[1:]
    module = loaded(command)
    return module, parser_of(command, module).parse_args(words)


def _with_new_names(words: list[str]) -> list[str]:
    """The words with a former spelling replaced, which a line on standard error says.

    Raises CliError for a command that is a study now.
    """
    for count in range(1, 3):
        name = " ".join(words[:count])
        if name in MOVED:
            study = " ".join(words[count : count + 1]) or "NAME"
            raise CliError(USAGE, f"palmd {name}: {MOVED[name].replace('NAME', study)}")
    if words and words[0] in RENAMED:
        new = RENAMED[words[0]]
        print(f"palmd {words[0]} is now: palmd {new}", file=sys.stderr)
        return [*new.split(), *words[1:]]
    return words


def _take_any_terminal() -> None:
    """A terminal or pipe that is not UTF-8 gets a ? for what it cannot show, instead of a traceback."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _start_logging() -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="palmd",
        description="An unknown planar object on two touchpad palms, reconstructed live.",
        epilog="commands:\n"
        + listed(below())
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
        epilog="names:\n" + listed(names),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", type=one_of(names), help="one of the names below")
    parser.add_argument("arguments", metavar="…", nargs=argparse.REMAINDER, help=f"see: {parser.prog} NAME --help")
    return parser
