"""Packages that palmd works without: what belongs to its optional extras."""

from __future__ import annotations

import importlib
import os
import re
import shlex
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from palmd.console.errors import BAD_INPUT, CliError


def only_without(package: str, error: ModuleNotFoundError) -> None:
    """Raises the error again when it is about anything else than the missing `package`."""
    if (error.name or "").partition(".")[0] != package:
        raise error


def missing(what: str, package: str, extra: str) -> CliError:
    """What cannot be done without an optional package, and what installs it."""
    return CliError(BAD_INPUT, f"{what} needs {package}, which is not installed: {install_line(package, extra)}")


def require(what: str, package: str, extra: str) -> None:
    """Raises CliError where an optional package is not installed, without loading it."""
    if find_spec(package) is None:
        raise missing(what, package, extra)


def install_line(package: str, extra: str) -> str:
    """What to type for an extra's packages to be in this environment, whatever palmd itself was installed from."""
    python = Path(sys.executable)
    if python.is_relative_to(Path.cwd()):
        python = Path(os.curdir) / python.relative_to(Path.cwd())
    return shlex.join([str(python), "-m", "pip", "install", *(_requirements(extra) or [package])])


def _requirements(extra: str) -> Sequence[str]:
    """What an extra consists of, as palmd's own metadata say; nothing where it runs without any."""
    from importlib import metadata  # 30 ms, only for a sentence about what is missing

    try:
        declared = metadata.requires("palmd") or []
    except metadata.PackageNotFoundError:
        return ()
    wanted = re.compile(rf"extra\s*==\s*['\"]{re.escape(extra)}['\"]")
    return [each.partition(";")[0].strip() for each in declared if wanted.search(each)]


def drawing(module: str) -> ModuleType | None:
    """The module that draws with matplotlib; None, with a word to the user, where that is not installed."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        only_without("matplotlib", error)
        print(f"no figure: matplotlib is not installed: {install_line('matplotlib', 'report')}", file=sys.stderr)
        return None
