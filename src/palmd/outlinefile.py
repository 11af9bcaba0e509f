"""Stored outlines: prior knowledge of an object, from JSON files or points in CSV.

Files that do not describe a convex outline about a centre of mass, in metres (JSON) or millimetres (CSV), are rejected
with the reason and the position.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palmd import polygon
from palmd.events import FloatArray
from palmd.score import support_at

SUFFIXES = (".json", ".csv")
H_SD_M = 5e-5  # default standard deviation: that of callipers and scanners
RHO_SD, LAMINA_RHO_SD = 0.01, 0.05  # relative, for rho given without its sd, and for that of a lamina
MASS_SD = 0.02  # relative, for a mass given without its sd
LEAST_NORMALS, LEAST_POINTS, MOST_POINTS = 90, 60, 5000
MEAN_RADIUS_M = (3e-3, 150e-3)  # range of objects that two palms can hold
MOST_MASS_KG = 20.0
HOLLOW_M = 5e-4  # an outline whose mean radius of curvature over ± `HOLLOW_WINDOW` is below −HOLLOW_M is not convex
HOLLOW_WINDOW = math.radians(10)  # a dent of this width is detected from a depth of 15 µm on
DENT_M = 5e-4  # largest depth of a point inside the hull that counts as digitising noise
ROUGH_M = 3e-4  # largest RMS distance of points from their smooth fit: more means a corner or too much noise
OPEN = 3.0  # largest gap between two points of a closed curve, in typical gaps (90th percentile)
MAX_BYTES = 64_000_000


class OutlineError(Exception):
    """An outline that cannot be used; its text is one line `file: what is wrong and what to do`."""


@dataclass(frozen=True, slots=True)
class Outline:
    """Prior knowledge of an object; SI units.

    h (360,): support function about the centre of mass on the normals of 0, 1, …, 359 degrees. h_sd (360,): its
    standard deviation after the best rotation. rho, rho_sd: radius of gyration. mass, mass_sd: NaN if unknown.
    """

    name: str
    h: FloatArray
    h_sd: FloatArray
    rho: float
    rho_sd: float
    mass: float
    mass_sd: float


class _InvalidOutlineError(ValueError):
    """Reason why a file is rejected; `place` is `line` or `line:column` if known."""

    def __init__(self, what: str, place: str = "") -> None:
        super().__init__(what)
        self.place = place


def read_outline(path: Path) -> Outline:
    """The outline in a `*.json` or `*.csv` file, resampled to whole degrees; raises OutlineError. Not for the loop.

    JSON: `theta_rad`, evenly spaced over the full circle from any start, and `h_m`; optional `h_sd_m`, `rho_m`,
    `rho_sd_m`, `mass_kg`, `mass_sd_kg`, `name`. Other keys are ignored, so that a reconstruction's result and a
    simulator's truth are valid outlines; a result with `converged: false` is not.

    CSV: a line `x_mm,y_mm`, then points in order round the object, in either direction; further columns are ignored.
    The comment lines `# com_mm: x, y`, `# rho_mm: …` and `# mass_kg: …` are optional; without them the body is a
    uniform lamina. Noise is averaged by a least-squares fit (`polygon.fitted`).
    """
    try:
        text = _text(path)
        if path.suffix.lower() == ".json":
            return _from_json(path.stem, text)
        if path.suffix.lower() == ".csv":
            return _from_csv(path.stem, text)
        raise _InvalidOutlineError("an outline is a .json or a .csv file")
    except OSError as error:
        raise OutlineError(f"{path}: {error.strerror or error}") from None
    except _InvalidOutlineError as error:
        raise OutlineError(f"{path}:{error.place + ':' if error.place else ''} {error}") from None


def read_library(path: Path) -> tuple[Outline, ...]:
    """The outline in a file, or those of all `*.json` and `*.csv` files in a folder, ordered by name.

    Raises OutlineError for the first invalid file, for two of the same name, and for a folder without outlines.
    """
    try:
        if not path.is_dir():
            return (read_outline(path),)
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
    except OSError as error:
        raise OutlineError(f"{path}: {error.strerror}") from None
    if not files:
        raise OutlineError(f"{path}: the folder holds no outline (*.json, *.csv)")
    by_name: dict[str, tuple[Path, Outline]] = {}
    for file in files:
        outline = read_outline(file)
        if outline.name in by_name:
            other = by_name[outline.name][0]
            raise OutlineError(f'{file}: has the same name "{outline.name}" as {other}; give each outline its own name')
        by_name[outline.name] = file, outline
    return tuple(by_name[name][1] for name in sorted(by_name))


def _text(path: Path) -> str:
    with path.open("rb") as stream:
        raw = stream.read(MAX_BYTES + 1)
    if len(raw) > MAX_BYTES:
        raise _InvalidOutlineError(f"longer than {MAX_BYTES // 1_000_000} MB: not an outline")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _InvalidOutlineError("not text (UTF-8)", str(raw.count(b"\n", 0, error.start) + 1)) from None
    if not text.strip():
        raise _InvalidOutlineError("the file is empty")
    return text


# ------------------------------------------------------------------------------------------- support functions


def _from_json(stem: str, text: str) -> Outline:
    content = _object(text)
    if content.get("converged") is False and content.get("verdict") != "partial":
        raise _InvalidOutlineError("is the result of a reconstruction that has not converged: it contains no outline")
    theta, h = _column(content, "theta_rad"), _column(content, "h_m")
    _same_length("h_m", h, theta)
    _check_circle(theta)
    _check_unit(float(h.mean()), "h_m", 1.0, "m")
    h_sd = _column(content, "h_sd_m") if content.get("h_sd_m") is not None else np.full(len(theta), H_SD_M)
    _same_length("h_sd_m", h_sd, theta)
    if (h_sd < 0).any():
        raise _InvalidOutlineError(
            f"h_sd_m[{int(h_sd.argmin())}] is {h_sd.min():g}; a standard deviation must not be negative"
        )
    name = content.get("name", stem)
    if not isinstance(name, str) or not name.strip():
        raise _InvalidOutlineError("name must be text")
    whole = support_at(h, polygon.degrees() - float(theta[0]))
    whole_sd = np.interp(polygon.degrees(), theta, h_sd, period=math.tau)
    constants = {key: _constant(content, key) for key in ("rho_m", "rho_sd_m", "mass_kg", "mass_sd_kg")}
    return _outline(
        name, whole, whole_sd, constants, "its first harmonic, the position of the centre of mass, is wrong"
    )


def _object(text: str) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise _InvalidOutlineError(f"not JSON: {error.msg}", f"{error.lineno}:{error.colno}") from None
    except (ValueError, RecursionError):
        raise _InvalidOutlineError("not JSON: excessive numbers or nesting") from None
    if not isinstance(content, dict):
        raise _InvalidOutlineError("must be an object {…} with theta_rad and h_m")
    return content


def _column(content: dict[str, Any], key: str) -> FloatArray:
    values = content.get(key)
    if not isinstance(values, list):
        raise _InvalidOutlineError(f"{key} is missing" if values is None else f"{key} must be a list of numbers")
    if len(values) < LEAST_NORMALS:
        raise _InvalidOutlineError(f"{key} has {len(values)} values; an outline needs {LEAST_NORMALS} or more")
    for i, value in enumerate(values):
        if not _is_number(value):
            raise _InvalidOutlineError(f"{key}[{i}] is {json.dumps(value)[:40]}, not a number")
    return np.array(values, dtype=np.float64)


def _constant(content: dict[str, Any], key: str) -> float:
    """The number given, NaN if there is none."""
    value = content.get(key)
    if value is None:
        return math.nan
    if not _is_number(value):
        raise _InvalidOutlineError(f"{key} is {json.dumps(value)[:40]}, not a number")
    return float(value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9  # NaN is not below


def _same_length(key: str, values: FloatArray, theta: FloatArray) -> None:
    if len(values) != len(theta):
        raise _InvalidOutlineError(f"{key} has {len(values)} values for {len(theta)} of theta_rad")


def _check_circle(theta: FloatArray) -> None:
    step = math.tau / len(theta)
    deviations = np.abs(theta - theta[0] - step * np.arange(len(theta)))
    if deviations.max() < 1e-3 * step:
        return
    if deviations[1] > 10 * step:
        raise _InvalidOutlineError(f"theta_rad steps by {theta[1] - theta[0]:g}: is it in degrees?")
    wrong = int((deviations >= 1e-3 * step).argmax())
    raise _InvalidOutlineError(
        f"theta_rad[{wrong}] is {theta[wrong]:g}; normals must be evenly spaced over the full circle, "
        f"{len(theta)} of them {step:.6g} apart, the first not repeated"
    )


# ---------------------------------------------------------------------------------------------------- points


@dataclass(frozen=True, slots=True)
class _Table:
    """Points (n, 2) in mm with their line numbers, and the comments: numbers and their line by key."""

    points: FloatArray
    lines: list[int]
    comments: dict[str, tuple[list[float], int]]


_COMMENTS = {"com_mm": 2, "rho_mm": 1, "mass_kg": 1}  # number of values of each


def _from_csv(stem: str, text: str) -> Outline:
    table = _table(text)
    points = _closed(table) * 1e-3
    fit = polygon.fitted(points)
    if fit.rms > ROUGH_M:
        raise _InvalidOutlineError(
            f"points deviate by {fit.rms * 1e3:.2f} mm (RMS) from a smooth outline: too noisy, or corners too sharp"
        )
    flat = polygon.lamina(polygon.boundary(fit.h))
    com = np.array(table.comments["com_mm"][0]) * 1e-3 if "com_mm" in table.comments else np.array(flat.centroid)
    h = fit.h - polygon.normals(polygon.degrees()) @ com
    h_sd = math.hypot(H_SD_M, fit.rms * math.sqrt(polygon.COEFFICIENTS / len(points)))
    rho, mass = (table.comments.get(key, ([math.nan], 0))[0][0] for key in ("rho_mm", "mass_kg"))
    constants = {"rho_m": rho * 1e-3, "rho_sd_m": math.nan, "mass_kg": mass, "mass_sd_kg": math.nan}
    return _outline(stem, h, np.full(len(h), h_sd), constants, "com_mm is wrong")


def _table(text: str) -> _Table:
    header, rows, lines = 0, [], []
    comments: dict[str, tuple[list[float], int]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        if line.lstrip().startswith("#"):
            key, _, value = line.lstrip("# \t").partition(":")
            if key.strip() in _COMMENTS:
                comments[key.strip()] = _numbers(value, _COMMENTS[key.strip()], number), number
        elif not header:
            names = [cell.strip() for cell in line.split(",")]
            if names[:2] != ["x_mm", "y_mm"]:
                raise _InvalidOutlineError(f"the header must be x_mm,y_mm, got {line.strip()[:40]}", str(number))
            header = len(names)
        else:
            rows.append(_numbers(line, header, number)[:2])
            lines.append(number)
    return _Table(np.array(rows).reshape(-1, 2), lines, comments)


def _numbers(text: str, count: int, line: int) -> list[float]:
    cells = text.split(",")
    if len(cells) != count:
        raise _InvalidOutlineError(f"expected {count} numbers, got {len(cells)}: {text.strip()[:40]}", str(line))
    values = []
    for cell in cells:
        try:
            value = float(cell)
        except ValueError:
            raise _InvalidOutlineError(f"{cell.strip()[:40] or 'nothing'} is not a number", str(line)) from None
        if not abs(value) < 1e9:
            raise _InvalidOutlineError(f"{cell.strip()} is out of range", str(line))
        values.append(value)
    return values


def _closed(table: _Table) -> FloatArray:
    """The points (mm) without a repeated first one; rejects anything but a closed convex curve, in either direction."""
    points, lines = table.points, table.lines
    if len(points) > 1 and (points[0] == points[-1]).all():
        points = points[:-1]
    if not LEAST_POINTS <= len(points) <= MOST_POINTS:
        raise _InvalidOutlineError(
            f"{len(points)} points; an outline needs {LEAST_POINTS} to {MOST_POINTS} round the object"
        )
    _check_unit(float(np.ptp(points, axis=0).mean()) / 2, "x_mm", 1e-3, "mm")
    gaps = polygon.gaps(points)
    widest = int(gaps.argmax())
    if gaps[widest] > OPEN * np.quantile(gaps, 0.9):
        following = lines[(widest + 1) % len(points)]
        raise _InvalidOutlineError(
            f"the curve is open: no point for {gaps[widest]:.1f} mm until line {following}", str(lines[widest])
        )
    crossing = polygon.crossing(points)
    if crossing is not None:
        one, other = (lines[i] for i in crossing)
        raise _InvalidOutlineError(f"the curve crosses itself near line {other}; points must be in order", str(one))
    turns = polygon.winding(points)
    if abs(abs(turns) - 1.0) > 0.5:
        raise _InvalidOutlineError(
            f"the curve winds {abs(turns):.0f} times round the object: it is closed twice or crosses itself",
            str(lines[0]),
        )
    depths = polygon.depths(points)
    deepest = int(depths.argmax())
    if depths[deepest] > DENT_M * 1e3:
        x, y = points[deepest]
        raise _InvalidOutlineError(
            f"the outline is not convex: ({x:.2f}, {y:.2f}) mm lies {depths[deepest]:.2f} mm inside the hull",
            str(lines[deepest]),
        )
    return points


# ------------------------------------------------------------------------------------------------------ both


def _check_unit(size: float, key: str, in_m: float, unit: str) -> None:
    """Reject a mean radius `size` outside the range of hand-held objects; `unit` is the file's, `in_m` metres."""
    low, high = MEAN_RADIUS_M
    if low <= size * in_m <= high:
        return
    guess = ""
    if low <= size * in_m * 1e3 <= high:
        guess = f": is {key} in {'metres' if unit == 'mm' else 'km'}?"
    elif low <= size * in_m * 1e-3 <= high:
        guess = f": is {key} in {'µm' if unit == 'mm' else 'mm'}?"
    raise _InvalidOutlineError(
        f"mean radius is {size:.3g} {unit}{guess or f', not {low * 1e3:g} to {high * 1e3:g} mm'}"
    )


def _outline(name: str, h: FloatArray, h_sd: FloatArray, constants: dict[str, float], about: str) -> Outline:
    """Check the outline as a whole; missing constants are taken from a uniform lamina of this outline.

    `about` explains a centre of mass that lies outside.
    """
    least = int(h.argmin())
    if h[least] <= 0.0:
        raise _InvalidOutlineError(
            f"h is {h[least] * 1e3:.2f} mm at {least}°: the centre of mass lies outside; {about}"
        )
    _check_convex(h)
    rho, rho_sd, mass, mass_sd = (constants[key] for key in ("rho_m", "rho_sd_m", "mass_kg", "mass_sd_kg"))
    has_rho = math.isfinite(rho)
    if not has_rho:
        rho = polygon.lamina(polygon.boundary(h)).rho
    mean = float(h.mean())
    if not 0.1 * mean < rho < 2 * mean:
        raise _InvalidOutlineError(
            f"the radius of gyration is {rho:.3g} m in a body of mean radius {mean:.3g} m: wrong unit?"
        )
    if math.isfinite(mass) and not 0.0 < mass < MOST_MASS_KG:
        raise _InvalidOutlineError(f"mass_kg is {mass:g}{': is it in grams?' if mass >= MOST_MASS_KG else ''}")
    for sd in (rho_sd, mass_sd):
        if sd < 0:
            raise _InvalidOutlineError(f"a standard deviation of {sd:g} is negative")
    return Outline(
        name=name,
        h=h,
        h_sd=h_sd,
        rho=rho,
        rho_sd=rho_sd if math.isfinite(rho_sd) else rho * (RHO_SD if has_rho else LAMINA_RHO_SD),
        mass=mass,
        mass_sd=mass_sd if math.isfinite(mass_sd) else mass * MASS_SD,
    )


def _check_convex(h: FloatArray) -> None:
    """Check v = h + h″ ≥ 0 on average over a window ± w, weighted by sin(w − |τ|):

    ∫ v(θ + τ) sin(w − |τ|) dτ = h(θ + w) + h(θ − w) − 2 cos w h(θ), which is exact for corners too and insensitive to
    noise.
    """
    w = round(math.degrees(HOLLOW_WINDOW))
    cos = math.cos(HOLLOW_WINDOW)
    v = (np.roll(h, w) + np.roll(h, -w) - 2 * cos * h) / (2 * (1 - cos))
    worst = int(v.argmin())
    if v[worst] < -HOLLOW_M:
        raise _InvalidOutlineError(
            f"the outline is not convex: at {worst}° its radius of curvature h + h″ is {v[worst] * 1e3:.1f} mm"
        )
