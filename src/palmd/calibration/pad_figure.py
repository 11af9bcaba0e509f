"""A pad's characteristic as a figure with four panels, after figure 3.12 of the paper; needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmd.calibration.pad_characteristic import (
    AXES,
    DEGREES_OF_FREEDOM,
    WINDOW,
    PadCharacteristic,
    Stroke,
    intervals_s,
    position_mm,
    residuals,
    strokes,
)
from palmd.config.pads import PadConfig
from palmd.devices.pad import PadReport
from palmd.events import FloatArray

_BLUE, _ORANGE, _GREY = "#0072b2", "#d55e00", "#808080"
_COLOURS = dict(zip(AXES, (_BLUE, _ORANGE), strict=True))
_LONGEST_PACKETS = 4.5


def save(packets: Sequence[PadReport], found: PadCharacteristic, config: PadConfig, path: Path) -> None:
    """Draw the reports and the results into an SVG; the same reports give the same file."""
    touches = strokes(packets, config)
    gaps_ms = intervals_s(touches) * 1e3
    with matplotlib.rc_context({"svg.hashsalt": "palmd", "font.size": 9.0, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(10.0, 7.5), layout="constrained")
        (trace, series), (histogram, noise) = figure.subplots(2, 2)
        _trace(trace, touches, config)
        _series(series, gaps_ms, found)
        _histogram(histogram, gaps_ms, found)
        _noise(noise, touches, found)
        figure.savefig(path, metadata={"Date": None})


def _trace(axes: Axes, touches: Sequence[Stroke], config: PadConfig) -> None:
    for stroke in touches:
        x, y = (position_mm(stroke.counts(axis), axis, config) for axis in AXES)
        axes.plot(x, y, color=_BLUE, linewidth=0.6)
    axes.set(xlabel=_axis_label("x", config), ylabel=_axis_label("y", config), aspect="equal", title="Trace")


def _series(axes: Axes, gaps_ms: FloatArray, found: PadCharacteristic) -> None:
    axes.scatter(np.arange(len(gaps_ms)), gaps_ms, 3.0, _BLUE, linewidths=0.0)
    axes.axhline(found.interval_mean_ms, color=_ORANGE)
    axes.set(xlabel="report", ylabel="time since the last (ms)", ylim=(0.0, _LONGEST_PACKETS * found.packet_time_ms))
    axes.set_title(f"Intervals: {found.interval_mean_ms:.1f} ms, sd {found.interval_sd_ms:.1f} ms")


def _histogram(axes: Axes, gaps_ms: FloatArray, found: PadCharacteristic) -> None:
    bins = np.arange(0.5, 12.0 * _LONGEST_PACKETS) * found.packet_time_ms / 12.0  # each band in the middle of a bin
    axes.hist(gaps_ms, bins.tolist(), color=_BLUE)
    for band in found.bands:
        at = band.packet_times * found.packet_time_ms
        axes.axvline(at, color=_ORANGE, linestyle="--")
        axes.annotate(
            f"{band.share:.0%}",
            (at, 0.96),
            xycoords=("data", "axes fraction"),
            xytext=(4, 0),
            textcoords="offset points",
        )
    axes.set(xlabel="interval (ms)", ylabel="number", title=f"Bands at multiples of {found.packet_time_ms:.2f} ms")


def _noise(axes: Axes, touches: Sequence[Stroke], found: PadCharacteristic) -> None:
    """The residuals, scaled by the degrees of freedom that the fit has taken."""
    scale = np.sqrt(WINDOW / DEGREES_OF_FREEDOM)
    axes_found = (found.x, found.y)
    spread = 5.0 * max(np.hypot(each.noise_mm, each.step_mm / np.sqrt(12.0)) for each in axes_found)
    for axis, of_axis in zip(AXES, axes_found, strict=True):
        scaled = residuals(touches, axis, of_axis.step_counts).ravel() * scale * of_axis.step_mm / of_axis.step_counts
        axes.hist(
            scaled, np.linspace(-spread, spread, 81).tolist(), density=True, histtype="step", color=_COLOURS[axis],
            label=f"{axis}: noise {of_axis.noise_mm:.3f} ± {of_axis.noise_sd_mm:.3f} mm, step {of_axis.step_mm:.3f} mm",
        )  # fmt: skip
    axes.set(xlabel="residual of the local fit (mm)", ylabel="density (1/mm)", title="Noise and rounding")
    axes.set_ylim(0.0, 1.3 * axes.get_ylim()[1])  # room for the legend
    axes.legend(loc="upper right")


def _axis_label(axis: str, config: PadConfig) -> str:
    return f"{axis}: from the hinge (mm)" if axis == config.axis else f"{axis}: across (mm)"
