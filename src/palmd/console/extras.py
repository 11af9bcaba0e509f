"""Optional packages, installed by palmd's extras."""

from __future__ import annotations

import importlib
import os
import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from palmd.console.errors import BAD_INPUT, CliError


def raise_if_other(package: str, error: ModuleNotFoundError) -> None:
    """Re-raise the error unless it is about the missing `package`."""
    if (error.name or "").partition(".")[0] != package:
        raise error


def missing(what: str, package: str, extra: str) -> CliError:
    """Error for `what`, which needs an optional package, with the command that installs it."""
    return CliError(BAD_INPUT, f"{what} needs {package}, which is not installed: {install_line(package, extra)}")


@contextmanager
def importing(what: str, package: str, extra: str) -> Iterator[None]:
    """Context of an import for `what`; CliError if its optional package is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise_if_other(package, error)
        raise missing(what, package, extra) from None


def require(what: str, package: str, extra: str) -> None:
    """Raise CliError if an optional package is not installed, without importing it."""
    if find_spec(package) is None:
        raise missing(what, package, extra)


def install_line(package: str, extra: str) -> str:
    """Command that installs an extra's packages in this environment, for any kind of palmd installation."""
    python = Path(sys.executable)
    if python.is_relative_to(Path.cwd()):
        python = Path(os.curdir) / python.relative_to(Path.cwd())
    return shlex.join([str(python), "-m", "pip", "install", *(_requirements(extra) or [package])])


def _requirements(extra: str) -> Sequence[str]:
    """Packages of an extra according to palmd's metadata; empty if palmd is not installed."""
    from importlib import metadata  # takes 30 ms, needed for error texts only

    try:
        declared = metadata.requires("palmd") or []
    except metadata.PackageNotFoundError:
        return ()
    wanted = re.compile(rf"extra\s*==\s*['\"]{re.escape(extra)}['\"]")
    return [each.partition(";")[0].strip() for each in declared if wanted.search(each)]


def drawing(module: str) -> ModuleType | None:
    """Import a module that needs matplotlib; if that is not installed, print how to install it and return None."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise_if_other("matplotlib", error)
        print(f"no figure: matplotlib is not installed: {install_line('matplotlib', 'report')}", file=sys.stderr)
        return None
