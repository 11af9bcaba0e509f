"""The result of a reconstruction, read back from its file."""

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
    """A result that cannot be used; its text is one line `file: what`."""


@dataclass(frozen=True, slots=True)
class Result:
    """What a reconstruction tells, from its file: trajectory t (s), psi (rad), radii (m, of each palm), the outline.

    theta, h, h_sd, touched: the outline's normals (rad), support function and its one-sigma (m), marks of touch.
    rho (m), mass (kg): NaN where there is none.
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
    """What `palmd reconstruct` has written; raises ResultError, also for a reconstruction without a trajectory."""
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ResultError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ResultError(f"{path}: not text (UTF-8)") from None
    except json.JSONDecodeError as error:
        raise ResultError(f"{path}:{error.lineno}:{error.colno}: not JSON: {error.msg}") from None
    except (ValueError, RecursionError):
        raise ResultError(f"{path}: not JSON: numbers or nesting beyond reason") from None
    if not isinstance(told, dict) or "trajectory" not in told:
        raise ResultError(f"{path}: is no result of a reconstruction: it has no trajectory")
    if not isinstance(told["trajectory"], dict):
        raise ResultError(f"{path}: the reconstruction has no trajectory: {told.get('reason') or 'not converged'}")
    columns = [_column(path, told["trajectory"], name) for name in ("t", "psi_rad", *(f"{name}_m" for name in RADII))]
    outline = [_column(path, told, name) for name in ("theta_rad", "h_m", "h_sd_m", "touched")]
    for group, names in ((columns, "trajectory"), (outline, "theta_rad, h_m, h_sd_m and touched")):
        if len({len(column) for column in group}) > 1 or len(group[0]) < 2:
            raise ResultError(f"{path}: {names} must be lists of one length, of two or more")
    if not (np.diff(columns[0]) > 0).all():
        raise ResultError(f"{path}: trajectory.t must increase")
    (t, psi, *radii), (theta, h, h_sd, touched) = columns, outline
    rho, mass = (_number_or_nan(told.get(name)) for name in ("rho_m", "mass_kg"))
    return Result(t, psi, np.stack(radii), theta, h, h_sd, touched != 0.0, rho, mass)


def _number_or_nan(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _column(path: Path, told: dict[str, Any], name: str) -> FloatArray:
    values = told.get(name)
    if not isinstance(values, list):
        raise ResultError(f"{path}: {name} is missing")
    for i, value in enumerate(values):
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise ResultError(f"{path}: {name}[{i}] is {json.dumps(value)[:40]}, not a number")
    return np.array(values, dtype=np.float64)
