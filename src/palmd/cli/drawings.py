"""Drawings of outlines and surfaces for other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from palmd.console.errors import BAD_INPUT, CliError, as_cli_error, writing
from palmd.console.extras import importing
from palmd.record.outline_files import OutlineCurves, Writer, curves_of, writer_of
from palmd.record.resultfile import ResultError, read_result

Drawing = TypeVar("Drawing")  # an outline, or a surface


def drawing(suffix: str) -> Writer:
    """Return the writer of a suffix in `outline_files.SUFFIXES`; CliError with install command if ezdxf is missing."""
    with importing("a DXF drawing", "ezdxf", "cad"):
        return writer_of(suffix)


def curves_of_result(path: Path) -> OutlineCurves:
    """Read the outline in a result of `palmd reconstruct`; CliError if the file is invalid."""
    with as_cli_error(ResultError):
        result = read_result(path)
    return curves_of(
        path.stem, result.theta, result.h, result.h_sd, result.touched, rho_m=result.rho, mass_kg=result.mass
    )


def write_drawing(curves: Drawing, target: Path, encode: Callable[[Drawing], bytes], source: Path) -> None:
    """Write the file; CliError if that fails, or if it is the `source` itself."""
    with writing(target):
        if target.exists() and target.samefile(source):
            raise CliError(BAD_INPUT, f"{target}: is the input; write to another file")
        target.write_bytes(encode(curves))
