"""Drawings of outlines and surfaces for other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import missing, raise_if_other
from palmd.record.outline_curves import OutlineCurves, curves_of
from palmd.record.outline_files import Writer, writer_of
from palmd.record.resultfile import ResultError, read_result

Drawing = TypeVar("Drawing")  # an outline, or a surface


def drawing(suffix: str) -> Writer:
    """Return the writer of a suffix in `outline_files.SUFFIXES`; CliError with install command if ezdxf is missing."""
    try:
        return writer_of(suffix)
    except ModuleNotFoundError as error:
        raise_if_other("ezdxf", error)
        raise missing("a DXF drawing", "ezdxf", "cad") from None


def curves_of_result(path: Path) -> OutlineCurves:
    """Read the outline in a result of `palmd reconstruct`; CliError if the file is invalid."""
    try:
        result = read_result(path)
    except ResultError as error:
        raise CliError(BAD_INPUT, str(error)) from None
    return curves_of(
        path.stem, result.theta, result.h, result.h_sd, result.touched, rho_m=result.rho, mass_kg=result.mass
    )


def write_drawing(curves: Drawing, target: Path, encode: Callable[[Drawing], bytes], source: Path) -> None:
    """Write the file; CliError if that fails, or if it is the `source` itself."""
    try:
        if target.exists() and target.samefile(source):
            raise CliError(BAD_INPUT, f"{target}: is the input; write to another file")
        target.write_bytes(encode(curves))
    except OSError as error:
        raise CliError(BAD_INPUT, f"{target}: cannot be written: {error.strerror or error}") from None
