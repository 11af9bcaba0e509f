"""Input of event logs, recorded runs and stored outlines, and output files and drawings, for commands."""

from __future__ import annotations

import argparse
import contextlib
import errno
import io
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO, TypeVar

from palmd.console.errors import BAD_INPUT, CliError, as_cli_error, writing
from palmd.console.extras import importing
from palmd.console.notes import print_notes
from palmd.console.output import strict_output
from palmd.console.progress import working
from palmd.outlinefile import Outline, OutlineError, read_library
from palmd.record import RunError, is_recording
from palmd.record.eventlog import MAP_LENGTH, EventLog, LogError
from palmd.record.outline_files import OutlineCurves, Writer, curves_of, writer_of
from palmd.record.resultfile import ResultError, read_result
from palmd.record.systems import NotYetError, System, read_log_of_any, system_of
from palmd.system.description import CALIBRATION_KEYS

STDOUT = Path("-")


def add_calibration_argument(parser: argparse.ArgumentParser) -> None:
    """Add the argument that replaces the log's standard deviations of the rig's constants."""
    parser.add_argument(
        "--calibration-sd", type=_calibration_sd, nargs="+", default=[], metavar="KEY=VALUE",
        help=f"standard deviations of the rig's constants, instead of the log's: {', '.join(_names())}",
    )  # fmt: skip


def _names() -> dict[str, str]:
    return {key: name for name, key in CALIBRATION_KEYS.items()} | {MAP_LENGTH: "map_length"}


def _calibration_sd(text: str) -> tuple[str, float]:
    key, _, value = text.partition("=")
    names = _names()
    if key not in names:
        raise argparse.ArgumentTypeError(f"there is no {key!r}; choose from {', '.join(names)}")
    try:
        sd = float(value)
    except ValueError:
        sd = math.nan
    if not 0.0 <= sd < math.inf:
        raise argparse.ArgumentTypeError(f"{key} must be a number from 0, got {value!r}")
    if key == MAP_LENGTH and sd == 0.0:
        raise argparse.ArgumentTypeError(f"{key} must be more than 0")
    return names[key], sd


def read(path: Path) -> EventLog:
    """Read a log of two palms on a hinge; its notes go to standard error. CliError if it is invalid.

    The format is determined by the first bytes; a file with a recording's suffix is always read as a recording.
    """
    system, log = read_any(path)
    if not isinstance(log, EventLog):
        raise CliError(BAD_INPUT, f"{path}: is a log of the system {system.name}; this needs two palms on a hinge")
    return log


def read_any(path: Path, calibration_sd: Sequence[tuple[str, float]] = ()) -> tuple[System, Any]:
    """As `read`, for any system; returns the system too.

    `calibration_sd`: arguments of `RigDescription.known_to`, instead of the log's own.
    """
    with as_cli_error(LogError, RunError), working(f"reading {path}"):
        system, log = _recorded(path) if is_recording(path) else read_log_of_any(path)
    print_notes(log.notes)
    with as_cli_error(NotYetError, before=f"{path}: "):
        return system, system.known_to(log, dict(calibration_sd))


def _recorded(path: Path) -> tuple[System, EventLog]:
    from palmd.record.run import read_run

    return system_of(None), read_run(path).event_log()


def read_outlines(path: Path) -> tuple[Outline, ...]:
    """Read the outline in a file, or all in a folder; CliError if one is invalid."""
    with as_cli_error(OutlineError):
        return read_library(path)


def check_not_input(outputs: Sequence[Path | None], inputs: Sequence[Path | None]) -> None:
    """Raise CliError if an output is one of the inputs."""
    read = [path for path in inputs if path is not None and path.exists()]
    for output in outputs:
        if output is not None and output.exists() and any(map(output.samefile, read)):
            raise CliError(BAD_INPUT, f"{output}: is an input; write to another file")


def check_writable(path: Path) -> None:
    """Raise CliError if `open_output` cannot write `path`; called before long computations."""
    code = errno.EISDIR if path.is_dir() else 0 if path.parent.is_dir() else errno.ENOENT
    if path != STDOUT and code:
        raise CliError(BAD_INPUT, f"{path}: cannot be written: {os.strerror(code)}")


@contextlib.contextmanager
def open_output(path: Path, log: Path) -> Iterator[TextIO]:
    """Open `path` for writing, `-` for standard output; CliError if that fails or if it is the `log` itself."""
    if path == STDOUT:
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(encoding="utf-8")  # as in a file: no character may be lost
        try:
            with strict_output():
                yield sys.stdout
        except BrokenPipeError:
            raise
        except OSError as error:
            raise CliError(BAD_INPUT, f"standard output: cannot be written: {error.strerror or error}") from None
        return
    with writing(path):
        if path.exists() and path.samefile(log):
            raise CliError(BAD_INPUT, f"{path}: is the log itself; write to another file")
        with path.open("w", encoding="utf-8") as stream:
            yield stream


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
