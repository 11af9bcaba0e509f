"""Validates configurations, motion plans and stored outlines; a plan's limits are those of the configurations given."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from palmd.console.errors import BAD_INPUT, CliError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "files", nargs="+", type=Path, metavar="FILE", help="a configuration or a plan (YAML), an outline (.json, .csv)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Tells everything that is wrong at once; CliError when anything is."""
    from palmd.motion.check import check_files
    from palmd.outlinefile import SUFFIXES

    outlines = [path for path in arguments.files if path.suffix.lower() in SUFFIXES]
    errors = check_files([path for path in arguments.files if path not in outlines]) + _outline_errors(outlines)
    if errors:
        raise CliError(BAD_INPUT, "\n".join(errors))
    for path in arguments.files:
        print(f"{path}: good")
    return 0


def _outline_errors(paths: Sequence[Path]) -> list[str]:
    from palmd.outlinefile import OutlineError, read_outline

    errors = []
    for path in paths:
        try:
            read_outline(path)
        except OutlineError as error:
            errors.append(str(error))
    return errors
