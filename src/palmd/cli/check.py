"""Validates configurations and motion plans; a plan's limits are those of the configurations beside it."""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.cli.errors import BAD_INPUT, CliError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="a configuration or a plan (YAML)")


def run(arguments: argparse.Namespace) -> int:
    """Tells everything that is wrong at once; CliError when anything is."""
    from palmd.motion.check import check_files

    errors = check_files(arguments.files)
    if errors:
        raise CliError(BAD_INPUT, "\n".join(errors))
    for path in arguments.files:
        print(f"{path}: good")
    return 0
