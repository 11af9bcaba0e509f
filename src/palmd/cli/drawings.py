"""How a command draws an outline for other programs: out of what, and with what."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import missing, only_without
from palmd.record.outline_curves import OutlineCurves, curves_of
from palmd.record.outline_files import Writer, writer_of
from palmd.record.resultfile import ResultError, read_result

Drawn = TypeVar("Drawn")  # an outline, or a surface


def drawing(suffix: str) -> Writer:
    """What makes files of a suffix of `outline_files.SUFFIXES`; CliError, with what mends it, without ezdxf."""
    try:
        return writer_of(suffix)
    except ModuleNotFoundError as error:
        only_without("ezdxf", error)
        raise missing("a DXF drawing", "ezdxf", "cad") from None


def curves_of_result(path: Path) -> OutlineCurves:
    """The outline in a file that `palmd reconstruct` has written; CliError when it cannot be used."""
    try:
        told = read_result(path)
    except ResultError as error:
        raise CliError(BAD_INPUT, str(error)) from None
    return curves_of(path.stem, told.theta, told.h, told.h_sd, told.touched, rho_m=told.rho, mass_kg=told.mass)


def write_drawing(curves: Drawn, target: Path, made: Callable[[Drawn], bytes], source: Path) -> None:
    """Writes the file; CliError when that cannot be, or when it is the `source` itself."""
    try:
        if target.exists() and target.samefile(source):
            raise CliError(BAD_INPUT, f"{target}: is what the outline is made of; write to another file")
        target.write_bytes(made(curves))
    except OSError as error:
        raise CliError(BAD_INPUT, f"{target}: cannot be written: {error.strerror or error}") from None
