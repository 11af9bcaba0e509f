"""Input of stored outlines for commands."""

from __future__ import annotations

from pathlib import Path

from palmd.console.errors import BAD_INPUT, CliError
from palmd.outlinefile import Outline, OutlineError, read_library


def read_outlines(path: Path) -> tuple[Outline, ...]:
    """Read the outline in a file, or all in a folder; CliError if one is invalid."""
    try:
        return read_library(path)
    except OutlineError as error:
        raise CliError(BAD_INPUT, str(error)) from None
