"""The `palmd` command; `cli.table` maps commands to modules, which are imported when called."""

from __future__ import annotations

import argparse
import io
import logging
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType

from palmd import __version__, blas
from palmd.cli.table import MOVED, RENAMED, SHORT, Command, listing, load_module, parser_of, subcommands
from palmd.console import output
from palmd.console.arguments import Parser, one_of
from palmd.console.errors import BAD_INPUT, USAGE, CliError
from palmd.logformat import formatter

INTERRUPTED = 128 + 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit status: 0 success, 1 wrong input, 2 usage, 3 the rig failed.

    Raises SystemExit for usage, help and version, as argparse does.
    """
    return status_of(lambda: _requested(argv))


def status_of(requested: Callable[[], tuple[ModuleType, argparse.Namespace]]) -> int:
    """Run the module and arguments that `requested` returns; return the exit status as `main` does."""
    blas.one_thread_from_here()
    # finding plug-ins would read the metadata of every package
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    output.make_tolerant()
    _take_any_terminal()
    try:
        module, arguments = requested()
        _start_logging()
        status: int = module.run(arguments)
    except CliError as error:
        print(error, file=sys.stderr)
        status = error.status
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:  # the reader has closed the output
        return 0
    except OSError as error:
        if error.errno not in output.LOST:
            raise
        print(f"{error.filename or 'an output'}: cannot be written: {error.strerror}", file=sys.stderr)
        status = BAD_INPUT
    lost = output.output_error()
    if lost:
        print(f"standard output: {lost}: output was lost", file=sys.stderr)
    return status


def _requested(argv: Sequence[str] | None) -> tuple[ModuleType, argparse.Namespace]:
    """Return the requested command's module and arguments. Raises CliError for a command that has moved."""
    given = _with_full_name(list(sys.argv[1:] if argv is None else argv))
    chosen = _parser().parse_args(given)
    if chosen.command is None:
        _parser().print_help(sys.stderr)
        raise SystemExit(USAGE)
    command, words = subcommands()[chosen.command], chosen.arguments
    names = subcommands(command.name)
    if command.module is None:
        chosen = _selecting(f"palmd {command.name}", command.help, "name", names).parse_args(words)
        command, words = names[chosen.name], chosen.arguments
    elif words and words[0] in names:
        command, words = names[words[0]], words[1:]
    module = load_module(command)
    return module, parser_of(command, module).parse_args(words)


def _with_full_name(words: list[str]) -> list[str]:
    """Replace a short command name, and a former one with a note on standard error.

    Raises CliError for a command that runs in a checkout now.
    """
    for count in range(1, 3):
        name = " ".join(words[:count])
        if name in MOVED:
            study = " ".join(words[count : count + 1]) or "NAME"
            raise CliError(USAGE, f"palmd {name}: {MOVED[name].replace('NAME', study)}")
        if name in RENAMED:
            print(f"palmd {name} is now: palmd {RENAMED[name]}", file=sys.stderr)
        if name in RENAMED or name in SHORT:
            return [*(RENAMED | SHORT)[name].split(), *words[count:]]
    return words


def _take_any_terminal() -> None:
    """Make terminals and pipes that are not UTF-8 show ? for unknown characters instead of raising."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _start_logging() -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])


def _parser() -> argparse.ArgumentParser:
    status = "\n\nexit status: 0 success, 1 the input is wrong, 2 usage, 3 the rig failed"
    description = "An unknown planar object on two touchpad palms, reconstructed live."
    parser = _selecting("palmd", description, "command", subcommands(), status)
    parser.add_argument("--version", action="version", version=f"palmd {__version__}")
    return parser


def _selecting(
    program: str, description: str, what: str, names: Mapping[str, Command], end: str = ""
) -> argparse.ArgumentParser:
    """Parser that selects one of the commands `names` and leaves its arguments."""
    parser = Parser(
        prog=program,
        description=description,
        epilog=f"{what}s:\n{listing(names)}{end}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    nargs = "?" if what == "command" else None
    parser.add_argument(what, metavar=what.upper(), nargs=nargs, type=one_of(names), help=f"one of the {what}s below")
    parser.add_argument("arguments", metavar="…", nargs=argparse.REMAINDER,
                        help=f"see: {program} {what.upper()} --help")  # fmt: skip
    return parser
