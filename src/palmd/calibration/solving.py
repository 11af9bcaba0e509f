"""Nonlinear least squares to full precision, for all calibrations. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from scipy.optimize import least_squares

from palmd.events import FloatArray

_PRECISION = 1e-14


def solved(residuals: Callable[[FloatArray], FloatArray], start: FloatArray, **options: Any) -> Any:
    """The solution as `scipy.optimize.least_squares` returns it: `x`, `fun`, `jac`, `success`."""
    return least_squares(residuals, start, x_scale="jac", ftol=_PRECISION, xtol=_PRECISION, gtol=_PRECISION, **options)
