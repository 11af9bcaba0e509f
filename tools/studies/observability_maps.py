"""Maps over the rates of palms and object: where the paper's codistributions degenerate; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure

from palmd.events import FloatArray
from tools.studies import last_second
from tools.studies.codistributions import GRAVITY_M_S2, scaled, singular_values
from tools.studies.equations.paper import POINT, Case, codistribution

NAME = "observability.svg"

_GRID = (50, 62)  # even, and without a point where the object turns with a palm
_COARSE_GRID = 21
_RATE_RAD_S, _SPIN_RAD_S = 2.0, 4.0
_SLOW_RATE_RAD_S = 0.6  # a second of it leaves the palms in their limits
_R1_M, _R2_M, _D1_M, _D2_M, _RHO_M, _MASS_KG = 0.021, 0.019, 1e-3, -2e-3, 0.014, 0.1
_GENERAL_SPIN_RAD_S = 1.0
_LEVELS = np.logspace(-7.0, -2.0, 11)
_ZERO, _POLE = "#d55e00", "white"


def save(folder: Path) -> Path:
    """Draws the maps into `folder` as `NAME`; always the same file. Takes some 10 s."""
    path = folder / NAME
    with matplotlib.rc_context({"svg.hashsalt": "palmd", "font.size": 9.0}):
        figure = Figure(figsize=(10.0, 8.0), layout="constrained")
        (equal, fixed), (general, told) = figure.subplots(2, 2)
        _equal_rates(equal)
        _palm1_fixed(fixed)
        _general(general)
        _last_second(told)
        figure.savefig(path, metadata={"Date": None})
    return path


def determinants(case: Case, points: FloatArray) -> FloatArray:
    """Of the codistribution of a square case at `points` (n, 12), SI; NaN where it is not defined.

    In the natural units of `tools/studies/codistributions.py`, the rows as they are: (4.46), (4.57).
    """
    rows = codistribution(case, scaled(points))
    values: FloatArray = np.full(len(rows), np.nan)
    defined = np.isfinite(rows).all(axis=(1, 2))
    values[defined] = np.linalg.det(rows[defined])
    return values


def states(**varied: FloatArray) -> FloatArray:
    """(n, 12) states as `POINT` orders them, SI: a typical object between typical palms but for what is `varied`."""
    phi1, phi2 = last_second.PHI1_RAD, last_second.PHI2_RAD
    s1 = (_R1_M * math.cos(phi2) + _R2_M) / math.sin(phi2) - _D1_M  # (3.13)
    s2 = (_R2_M * math.cos(phi2) + _R1_M) / math.sin(phi2) + _D2_M  # (3.14)
    typical = (_R1_M, _R2_M, 0.0, s1, s2, phi1, 0.0, phi2, 0.0, _RHO_M, _MASS_KG, GRAVITY_M_S2)
    columns = [varied.get(name, np.array(value)) for name, value in zip(POINT, typical, strict=True)]
    return np.stack(np.broadcast_arrays(*columns), axis=-1).reshape(-1, len(POINT))


def _equal_rates(axes: Axes) -> None:
    omega1, omega0 = _grid(_RATE_RAD_S, _SPIN_RAD_S)
    _smallest(axes, "equal rates", omega1, omega0, states(omega1=omega1, omega0=omega0))
    axes.axhline(0.0, color=_ZERO)
    axes.axvline(0.0, color=_ZERO, label="(4.46) is zero")
    axes.plot(omega1[0], omega1[0], color=_POLE, linestyle=":", label="object turns with the palms")
    _label(axes, "Both palms at one constant rate", "rate of both palms ω1 (rad/s)", "rate of the object ω0 (rad/s)")


def _palm1_fixed(axes: Axes) -> None:
    omega2, omega0 = _grid(_RATE_RAD_S, _SPIN_RAD_S)
    points = states(omega2=omega2, omega0=omega0)
    _smallest(axes, "palm 1 fixed", omega2, omega0, points)
    axes.axhline(0.0, color=_ZERO)
    axes.axvline(0.0, color=_ZERO, label="(4.57) is zero")
    # ω0 ω2 times the bracket of (4.57): without its poles, its sign shows where the bracket is zero
    smooth = determinants("palm 1 fixed", points).reshape(omega0.shape) * (omega2 - omega0) ** 3
    with np.errstate(divide="ignore", invalid="ignore"):
        bracket = smooth / (omega0**2 * omega2)
    axes.contour(omega2, omega0, bracket, levels=[0.0], colors=_ZERO, linestyles="--")
    axes.plot([], [], color=_ZERO, linestyle="--", label="its bracket is zero")
    axes.plot(omega2[0], omega2[0], color=_POLE, linestyle=":", label="object turns with palm 2")
    _label(axes, "Palm 1 fixed", "rate of palm 2 ω2 (rad/s)", "rate of the object ω0 (rad/s)")


def _general(axes: Axes) -> None:
    omega1, omega2 = _grid(_RATE_RAD_S, _RATE_RAD_S)
    points = states(omega1=omega1, omega2=omega2, omega0=np.array(_GENERAL_SPIN_RAD_S))
    _smallest(axes, "general", omega1, omega2, points)
    slide1 = omega1[0] - _GENERAL_SPIN_RAD_S
    ratio = (_D1_M / _D2_M) ** 2 * (_RHO_M**2 - _D2_M**2) / (_RHO_M**2 - _D1_M**2)
    axes.plot(omega1[0], (ratio - 1.0) * slide1, color=_ZERO, label="determinant is zero")
    axes.axvline(_GENERAL_SPIN_RAD_S, color=_POLE, linestyle=":", label="object turns with a palm")
    axes.plot(omega1[0], -slide1, color=_POLE, linestyle=":")
    axes.set_ylim(-_RATE_RAD_S, _RATE_RAD_S)
    title = f"General case by its input fields, ω0 = {_GENERAL_SPIN_RAD_S:g} rad/s"
    _label(axes, title, "rate of palm 1 ω1 (rad/s)", "rate of palm 2 ω2 (rad/s)")


def _last_second(axes: Axes) -> None:
    rates = np.linspace(-_SLOW_RATE_RAD_S, _SLOW_RATE_RAD_S, _COARSE_GRID)
    values = np.array([[last_second.told(float(one), float(two)) for one in rates] for two in rates])
    drawn = axes.contourf(rates, rates, values, levels=12, cmap="cividis")
    _bar(axes, drawn, "prior / error of what is told worst")
    _label(
        axes,
        "One second of readings, noise and friction counted",
        "rate of palm 1 ω1 (rad/s)",
        "rate of palm 2 ω2 (rad/s)",
    )


def _grid(horizontal: float, vertical: float) -> Sequence[FloatArray]:
    return np.meshgrid(np.linspace(-horizontal, horizontal, _GRID[0]), np.linspace(-vertical, vertical, _GRID[1]))


def _smallest(axes: Axes, case: Case, x: FloatArray, y: FloatArray, points: FloatArray) -> None:
    values = singular_values(case, points)[:, -1].reshape(x.shape)
    shown = np.ma.masked_invalid(np.clip(values, _LEVELS[0], None))
    drawn = axes.contourf(x, y, shown, levels=_LEVELS, norm=LogNorm(), cmap="viridis", extend="max")
    _bar(axes, drawn, "smallest scaled singular value")


def _bar(axes: Axes, drawn: ContourSet, label: str) -> None:
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    figure.colorbar(drawn, ax=axes, label=label)


def _label(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set(title=title, xlabel=x, ylabel=y)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower left", fontsize=7.5, facecolor="#808080", labelcolor="white", framealpha=0.85)
