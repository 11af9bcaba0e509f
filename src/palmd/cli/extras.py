"""Packages that palmd works without: what belongs to its optional extras."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType


def only_without(package: str, error: ModuleNotFoundError) -> None:
    """Raises the error again when it is about anything else than the missing `package`."""
    if (error.name or "").partition(".")[0] != package:
        raise error


def drawing(module: str) -> ModuleType | None:
    """The module that draws with matplotlib; None, with a word to the user, where that is not installed."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        only_without("matplotlib", error)
        print("no figure: matplotlib is not installed (extra `report`)", file=sys.stderr)
        return None
