"""What a reconstruction says, as one JSON object. Pure."""

from __future__ import annotations

import math
from typing import Any

from palmd.events import FloatArray
from palmd.observer.reconstruct import Reconstruction


def as_line(answer: Reconstruction) -> dict[str, Any]:
    """The result as `palmd reconstruct` writes it: SI units, the unit in each name, None where there is no value."""
    return {
        "converged": bool(answer.converged),
        "reason": answer.reason or None,
        "chi2": _number(answer.chi2),
        "theta_rad": _numbers(answer.theta),
        "h_m": _column(answer.h),
        "h_sd_m": _column(answer.h_sd),
        "touched": None if answer.touched is None else answer.touched.astype(int).tolist(),
        "rho_m": _number(answer.rho),
        "rho_sd_m": _number(answer.rho_sd),
        "mu": _number(answer.mu),
        "mu_sd": _number(answer.mu_sd),
        "mass_kg": _number(answer.mass),
        "mass_sd_kg": _number(answer.mass_sd),
        "trajectory": _trajectory(answer),
        "seconds": _number(answer.seconds),
    }


def _trajectory(answer: Reconstruction) -> dict[str, list[float | None]] | None:
    if not len(answer.t):
        return None
    return {
        "t": _numbers(answer.t),
        "psi_rad": _numbers(answer.psi),
        "omega0_rad_s": _numbers(answer.omega0),
        "r1_m": _numbers(answer.r1),
        "r2_m": _numbers(answer.r2),
    }


def _column(values: FloatArray | None) -> list[float | None] | None:
    return None if values is None else _numbers(values)


def _numbers(values: FloatArray) -> list[float | None]:
    return [_number(value) for value in values.tolist()]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
