"""How a command reads stored outlines."""

from __future__ import annotations

from pathlib import Path

from palmd.console.errors import BAD_INPUT, CliError
from palmd.outlinefile import Outline, OutlineError, read_library


def read_outlines(path: Path) -> tuple[Outline, ...]:
    """The outline in a file, or all in a folder; CliError when one cannot be used."""
    try:
        return read_library(path)
    except OutlineError as error:
        raise CliError(BAD_INPUT, str(error)) from None
