"""Packages that palmd works without: what belongs to its optional extras."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

from palmd.console.errors import BAD_INPUT, CliError


def only_without(package: str, error: ModuleNotFoundError) -> None:
    """Raises the error again when it is about anything else than the missing `package`."""
    if (error.name or "").partition(".")[0] != package:
        raise error


def missing(what: str, package: str, extra: str) -> CliError:
    """What cannot be done without an optional package, and what installs it."""
    return CliError(BAD_INPUT, f"{what} needs {package}, which is not installed: pip install 'palmd[{extra}]'")


def drawing(module: str) -> ModuleType | None:
    """The module that draws with matplotlib; None, with a word to the user, where that is not installed."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        only_without("matplotlib", error)
        print("no figure: matplotlib is not installed (pip install 'palmd[report]')", file=sys.stderr)
        return None
