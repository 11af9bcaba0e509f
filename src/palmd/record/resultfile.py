"""Read the result of a reconstruction from its file."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.system.mechanism import RADII

Bools = npt.NDArray[np.bool_]


class ResultError(Exception):
    """A result that cannot be used; the text is one line `file: what is wrong`."""


@dataclass(frozen=True, slots=True)
class Result:
    """A result of `palmd reconstruct`: trajectory t (s), psi (rad), radii (m, one row per palm), and the outline.

    theta, h, h_sd, touched: the outline's normals (rad), support function and its standard deviation (m), and which
    normals were touched. rho (m), mass (kg): NaN if unknown.
    """

    t: FloatArray
    psi: FloatArray
    radii: FloatArray
    theta: FloatArray
    h: FloatArray
    h_sd: FloatArray
    touched: Bools
    rho: float = math.nan
    mass: float = math.nan


def read_result(path: Path) -> Result:
    """Read a file of `palmd reconstruct`; raises ResultError, also for a result without a trajectory."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ResultError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ResultError(f"{path}: not text (UTF-8)") from None
    except json.JSONDecodeError as error:
        raise ResultError(f"{path}:{error.lineno}:{error.colno}: not JSON: {error.msg}") from None
    except (ValueError, RecursionError):
        raise ResultError(f"{path}: not JSON: a number is too long or nesting too deep") from None
    if not isinstance(content, dict) or "trajectory" not in content:
        raise ResultError(f"{path}: is not a result of palmd reconstruct: it has no trajectory")
    if not isinstance(content["trajectory"], dict):
        raise ResultError(f"{path}: the reconstruction has no trajectory: {content.get('reason') or 'not converged'}")
    columns = [
        _column(path, content["trajectory"], name) for name in ("t", "psi_rad", *(f"{name}_m" for name in RADII))
    ]
    outline = [_column(path, content, name) for name in ("theta_rad", "h_m", "h_sd_m", "touched")]
    for group, names in ((columns, "trajectory"), (outline, "theta_rad, h_m, h_sd_m and touched")):
        if len({len(column) for column in group}) > 1 or len(group[0]) < 2:
            raise ResultError(f"{path}: {names} must be lists of equal length, with two or more values")
    if not (np.diff(columns[0]) > 0).all():
        raise ResultError(f"{path}: trajectory.t must increase")
    (t, psi, *radii), (theta, h, h_sd, touched) = columns, outline
    rho, mass = (_number_or_nan(content.get(name)) for name in ("rho_m", "mass_kg"))
    return Result(t, psi, np.stack(radii), theta, h, h_sd, touched != 0.0, rho, mass)


def _number_or_nan(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _column(path: Path, content: dict[str, Any], name: str) -> FloatArray:
    values = content.get(name)
    if not isinstance(values, list):
        raise ResultError(f"{path}: {name} is missing")
    for i, value in enumerate(values):
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise ResultError(f"{path}: {name}[{i}] is {json.dumps(value)[:40]}, not a number")
    return np.array(values, dtype=np.float64)
