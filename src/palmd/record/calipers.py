"""Caliper measurements of captured objects: the table of a capture bundle, and scores of a reconstruction against it.

Calipers measure the largest and the smallest width of an outline, independent of its orientation. With the support
function h(θ) the width along θ is h(θ) + h(θ + π).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from palmd.events import FloatArray

TRUTH = "truth.csv"
SCALE_RELATIVE_SD = 1e-3
"""Standard deviation of the weighing scale, relative to the mass."""


@dataclass(frozen=True, slots=True)
class Measured:
    """One object: its recording and photo (files of the bundle), its widths by calipers and its weighed mass.

    sd_mm: standard deviation of a width. mass_g: NaN if it was not weighed.
    """

    name: str
    run: str
    photo: str
    largest_mm: float
    smallest_mm: float
    sd_mm: float
    mass_g: float = math.nan


class CaliperError(ValueError):
    """The table of a bundle is invalid; the text says where and what to do."""


def widths_mm(h_m: FloatArray) -> FloatArray:
    """The width (mm) along each of evenly spaced normals, from h (m); raises ValueError for an odd number of them."""
    if len(h_m) % 2:
        raise ValueError(f"needs an even number of normals, got {len(h_m)}")
    return np.asarray((h_m + np.roll(h_m, -(len(h_m) // 2))) * 1e3)


def extremes_mm(h_m: Sequence[float] | FloatArray) -> tuple[float, float]:
    """The largest and the smallest width (mm)."""
    widths = widths_mm(np.asarray(h_m, dtype=float))
    return float(widths.max()), float(widths.min())


def as_csv(rows: Iterable[Measured]) -> str:
    """Format the table as CSV text."""
    out = io.StringIO()
    writer = csv.DictWriter(out, [field.name for field in fields(Measured)], lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow(
            {key: f"{value:g}" if isinstance(value, float) else value for key, value in asdict(row).items()}
        )
    return out.getvalue()


def read_table(folder: Path) -> list[Measured]:
    """Read the table of a bundle; raises CaliperError with the line and column that are wrong."""
    path = folder / TRUTH
    try:
        rows = list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error.reason
        raise CaliperError(f"{path}: {reason}; a bundle of palmd capture contains this table") from None
    if not rows:
        raise CaliperError(f"{path}: no objects listed; write one line for each recording")
    return [_row(path, number, row) for number, row in enumerate(rows, 2)]


def _row(path: Path, line: int, row: Mapping[str | None, Any]) -> Measured:
    values: dict[str, Any] = {}
    for field in fields(Measured):
        text = row.get(field.name)
        if text is None:
            raise CaliperError(f"{path}:{line}: column {field.name} is missing")
        if field.type != "float":
            values[field.name] = text
            continue
        try:
            values[field.name] = float(text)
        except ValueError:
            raise CaliperError(f"{path}:{line}: {field.name} must be a number, got {text!r}") from None
    found = Measured(**values)
    if not (0.0 < found.smallest_mm <= found.largest_mm < math.inf and 0.0 < found.sd_mm < math.inf):
        raise CaliperError(f"{path}:{line}: needs 0 < smallest_mm ≤ largest_mm and sd_mm > 0, all finite")
    if not (math.isnan(found.mass_g) or 0.0 < found.mass_g < math.inf):
        raise CaliperError(f"{path}:{line}: mass_g must be more than 0, or nan where it was not weighed")
    recording = path.parent / found.run
    if not recording.resolve().is_relative_to(path.parent.resolve()):
        raise CaliperError(f"{path}:{line}: run must lie in the bundle, got {found.run}")
    if not recording.is_file():
        raise CaliperError(f"{path}:{line}: there is no recording {recording}")
    return found


@dataclass(frozen=True, slots=True)
class Score:
    """An estimate and a measurement, each with its standard deviation.

    whole: False if not all normals were touched; the estimated width is then only a bound. `bound_sign` is 1 for the
    largest width (the estimate may be smaller than the calipers') and -1 for the smallest (it may be larger).
    """

    estimate: float
    sd: float
    measured: float
    measured_sd: float
    whole: bool = True
    bound_sign: int = 0

    @property
    def sigmas(self) -> float:
        """Estimate minus measurement in combined standard deviations; for a bound, 0 unless it is violated."""
        deviation = (self.estimate - self.measured) / math.hypot(self.sd, self.measured_sd)
        return deviation if self.whole else self.bound_sign * max(self.bound_sign * deviation, 0.0)


def scored(result: Mapping[str, Any], measured: Measured) -> dict[str, Score]:
    """Score the widths (mm) and mass (g) in a result of `palmd reconstruct`; quantities without a value are omitted.

    A width is used if the outline was touched at both ends. The ends share the rig's errors, so their standard
    deviations are added.
    """
    found: dict[str, Score] = {}
    if result.get("mass_kg") is not None and not math.isnan(measured.mass_g):
        found["mass_g"] = Score(
            result["mass_kg"] * 1e3, result["mass_sd_kg"] * 1e3, measured.mass_g, SCALE_RELATIVE_SD * measured.mass_g
        )
    h, sd, touched = (result.get(key) for key in ("h_m", "h_sd_m", "touched"))
    if h is None or sd is None or touched is None:
        return found
    widths, sds = widths_mm(np.array(h)), widths_mm(np.array(sd))
    ends = np.array(touched, dtype=bool)
    known = ends & np.roll(ends, -(len(ends) // 2))
    for name, sign, calipers in (("largest_mm", 1, measured.largest_mm), ("smallest_mm", -1, measured.smallest_mm)):
        if known.any():
            index = int(np.where(known, sign * widths, -np.inf).argmax())
            found[name] = Score(
                float(widths[index]), float(sds[index]), calipers, measured.sd_mm, bool(known.all()), sign
            )
    return found
