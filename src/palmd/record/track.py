"""A camera's track of object and palms: a table of times, positions and angles in the camera's clock and frame."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.system.mechanism import PALMS

TIME = "t_s"
OBJECT = ("object_x_mm", "object_y_mm", "object_angle_deg")
ANGLES = tuple(f"palm{palm}_angle_deg" for palm in PALMS)
MIN_ROWS = 30
EXTENT_MM = (0.2, 1000.0)  # plausible range of a mark's motion; others hint at a wrong unit
MAX_BYTES = 200_000_000


class TrackError(Exception):
    """A track that cannot be used; the text is one line `file:line: what is wrong`."""


@dataclass(frozen=True, slots=True)
class CameraTrack:
    """n rows at times `t` (s) of the camera's clock; NaN where the camera saw nothing.

    mark (n, 2): position of the mark on the object (m). angle (n): of the object's arrow; palms (n, 2): of palm 1 and
    palm 2, that is φ1 and φ12. Angles in rad, on any branch, in the camera's frame.
    """

    t: FloatArray
    mark: FloatArray
    angle: FloatArray
    palms: FloatArray


class _BadRowError(ValueError):
    """What is wrong with one line."""


def read_track(path: Path) -> CameraTrack:
    """Read a track from a CSV file; raises TrackError. Not for the loop.

    The header names the columns, in any order: `t_s,object_x_mm,object_y_mm,object_angle_deg`, and optionally
    `palm1_angle_deg,palm2_angle_deg`; others are ignored. Empty cells and NaN mean not seen. Raises TrackError for
    times that do not increase, ragged rows, fewer than `MIN_ROWS` rows that show the object, and implausible positions.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise TrackError(f"{path}: longer than {MAX_BYTES // 1_000_000} MB")
        with path.open(encoding="utf-8-sig", newline="") as stream:
            table = _table(path, stream)
    except OSError as error:
        raise TrackError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise TrackError(f"{path}: not text (UTF-8)") from None
    problem = _problem(table)
    if problem:
        raise TrackError(f"{path}: {problem}")
    seen = _seen(table)
    mark = np.where(seen[:, None], table[:, 1:3] * 1e-3, np.nan)
    return CameraTrack(table[:, 0], mark, np.where(seen, np.radians(table[:, 3]), np.nan), np.radians(table[:, 4:6]))


def _table(path: Path, stream: TextIO) -> FloatArray:
    """Columns t, the object's three, the palms' two (n, 6), in the file's units."""
    rows = csv.reader(stream)
    table: list[list[float]] = []
    try:
        columns = _columns(next(rows, []))
        for row in rows:
            if any(cell.strip() for cell in row):
                table.append(_values(row, columns, table[-1][0] if table else -math.inf))
    except (_BadRowError, csv.Error) as error:
        raise TrackError(f"{path}:{max(rows.line_num, 1)}: {error}") from None
    return np.array(table).reshape(len(table), 1 + len(OBJECT) + len(ANGLES))


def _problem(table: FloatArray) -> str:
    """Why the whole table is not a valid track; empty if it is."""
    seen = _seen(table)
    if seen.sum() < MIN_ROWS:
        return f"{int(seen.sum())} rows show the object; {MIN_ROWS} are needed"
    extent = float(np.ptp(table[seen, 1:3], axis=0).max())
    if extent < EXTENT_MM[0]:
        return f"the object moves by only {extent:.3g} mm: are object_x_mm and object_y_mm in metres?"
    if extent > EXTENT_MM[1]:
        return f"the object moves by {extent:.3g} mm: are object_x_mm and object_y_mm in µm?"
    return ""


def _seen(table: FloatArray) -> npt.NDArray[np.bool_]:
    return np.asarray(np.isfinite(table[:, 1:4]).all(axis=1))


def _columns(header: list[str]) -> dict[str, int]:
    """Index of each known column, and under "" the number of columns."""
    names = [cell.strip() for cell in header]
    if not any(names):
        raise _BadRowError("the file is empty")
    for name in (TIME, *OBJECT):
        if names.count(name) != 1:
            fault = "twice" if name in names else "missing"
            raise _BadRowError(f"the column {name} is {fault}; required columns: {','.join((TIME, *OBJECT))}")
    return {name: names.index(name) for name in (TIME, *OBJECT, *ANGLES) if name in names} | {"": len(names)}


def _values(row: list[str], columns: dict[str, int], before: float) -> list[float]:
    if len(row) != columns[""]:
        raise _BadRowError(f"{len(row)} cells under {columns['']} columns")
    values = [_number(name, row[columns[name]]) if name in columns else math.nan for name in (TIME, *OBJECT, *ANGLES)]
    if not math.isfinite(values[0]):
        raise _BadRowError(f"{TIME} is missing")
    if values[0] <= before:
        raise _BadRowError(f"{TIME} is {values[0]:g} after {before:g}: time must increase")
    return values


def _number(name: str, cell: str) -> float:
    try:
        value = float(cell) if cell.strip() else math.nan
    except ValueError:
        raise _BadRowError(f"{name} is {cell.strip()[:40]!r}, not a number") from None
    if abs(value) == math.inf:
        raise _BadRowError(f"{name} is infinite")
    return value
