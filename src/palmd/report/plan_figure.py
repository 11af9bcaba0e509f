"""Figure of a motion plan: angles, rates, accelerations, palm positions, usage of limits; needs matplotlib."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmd.config.two_palms import Config
from palmd.events import FloatArray
from palmd.motion.kinematics import RigGeometry
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import Trajectory
from palmd.motion.usage import LimitUsage, Sampled, sampled, usage
from palmd.report.axes import BLACK, BLUE, GREEN, GREY, ORANGE, WIDTH_IN, figure_style, line
from palmd.system.mechanism import JOINTS, PALMS

_COLOURS = (BLUE, ORANGE)
_NEAR = 0.9
_PALMS_DRAWN = 7
_EDGE = 60
_GLYPHS = dict(zip(JOINTS, ("φ₁", "φ₂"), strict=True))
_DOTTED = (0, (1, 2))


def save(trajectory: Trajectory, limits: MotionLimits, config: Config, path: Path) -> str:
    """Draw the plan into a file by its suffix; returns a line with its duration and the limit that it uses most."""
    motion = sampled(trajectory)
    used = usage(motion, limits)
    with figure_style(trajectory.name):
        figure = _draw(trajectory, motion, used, limits, RigGeometry.from_config(config))
        figure.savefig(path, metadata={"Date": None} if path.suffix.lower() == ".svg" else None, dpi=150)
    return f"{duration_text(trajectory, motion)}; nearest to its limit: {used[0].text()}"


def duration_text(trajectory: Trajectory, motion: Sampled) -> str:
    """The duration of the plan as text."""
    last = trajectory.rounds[-1].segments[-1]
    if trajectory.labels[-1] == "explore":
        before = f"{motion.t[-1]:.3g} s, then " if motion.t[-1] > 0.0 else ""
        goal = getattr(last, "goal", None)
        most = f", {goal.time_limit_s:g} s at most" if goal is not None else ""
        return f"{before}explores; its motion is chosen at run time{most}"
    if math.isinf(trajectory.duration):
        return f"repeats without end, {trajectory.rounds[-1].duration:.4g} s per round"
    return f"{trajectory.duration:.4g} s"


def _draw(
    trajectory: Trajectory, motion: Sampled, used: list[LimitUsage], limits: MotionLimits, geometry: RigGeometry
) -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 7.2), layout="constrained")
    drawn = "" if motion.whole else f"; drawn: {motion.t[-1]:.3g} s"
    figure.suptitle(f"{trajectory.name}: {duration_text(trajectory, motion)}{drawn}", fontsize=10)
    halves = figure.add_gridspec(2, 1, height_ratios=(3.0, 1.15))
    above, below = figure.add_subfigure(halves[0]), figure.add_subfigure(halves[1])
    grid = above.add_gridspec(3, 2, width_ratios=(1.15, 1.0))
    angles, rates, accelerations = (above.add_subplot(grid[row, 0]) for row in range(3))
    _over_time(angles, motion.t, np.degrees(motion.angles), "angle (°)")
    for (low, high), colour in zip(limits.angles, _COLOURS, strict=True):
        for edge in (low, high):
            angles.axhline(math.degrees(edge), color=colour, linewidth=0.7, linestyle=_DOTTED)
    angles.legend(loc="upper right", ncols=2)
    _over_time(rates, motion.t, np.degrees(motion.rates), "rate (°/s)")
    _limited(rates, math.degrees(limits.rate), np.degrees(motion.rates))
    _over_time(accelerations, motion.t, np.degrees(motion.accelerations), "acceleration (°/s²)")
    _limited(accelerations, math.degrees(limits.acceleration), np.degrees(motion.accelerations))
    accelerations.set_xlabel("time (s); dotted: limits")
    _draw_palms(above.add_subplot(grid[:, 1]), motion, limits, geometry)
    _draw_limit_usage(below.subplots(), used)
    return figure


def _over_time(axes: Axes, t: FloatArray, values: FloatArray, label: str) -> None:
    for joint, column, colour in zip(JOINTS, values.T, _COLOURS, strict=True):
        line(axes, t, column, color=colour, label=_GLYPHS.get(joint, joint))
    axes.set_ylabel(label)
    axes.set_xlim(0.0, max(float(t[-1]), 1e-3))


def _limited(axes: Axes, most: float, values: FloatArray) -> None:
    """Draw both limits if they are near the plan's values."""
    reached = float(np.abs(values).max(initial=0.0))
    for edge in (-most, most):
        axes.axhline(edge, color=GREY, linewidth=0.8, linestyle=_DOTTED)
    reach = 1.1 * (most if reached > 0.3 * most else max(reached, 1e-3))
    axes.set_ylim(-reach, reach)
    if reach < most:
        axes.set_title(f"limit ± {most:g}", loc="right", color=GREY, fontsize=7, pad=1)


def _draw_palms(axes: Axes, motion: Sampled, limits: MotionLimits, geometry: RigGeometry) -> None:
    """Draw the palms in the world frame at some times, and the paths of the hinge and of the point held by the arm."""
    axes.fill(
        *_arm_point(_corners(limits), geometry).T, color=GREEN, alpha=0.1, linewidth=0.0, label="permitted region"
    )
    hinge, tip = _hinge(motion.angles, geometry), _arm_point(motion.angles, geometry)
    base = np.array((geometry.base_x, geometry.base_y)) * 1e3
    moments = np.unique(np.linspace(0, len(motion.t) - 1, _PALMS_DRAWN).astype(int))
    for number, index in enumerate(moments):
        shade = 0.25 + 0.75 * (number + 1) / len(moments)
        for ends, colour in (((base, hinge[index]), _COLOURS[0]), ((hinge[index], tip[index]), _COLOURS[1])):
            axes.plot(*np.column_stack(ends), color=colour, alpha=shade, linewidth=1.4)
    axes.plot(*hinge.T, color=BLACK, linewidth=0.8, label="hinge between the palms")
    axes.plot(*tip.T, color=GREEN, linewidth=1.0, label="point held by the arm")
    axes.plot(*base, "o", color=BLUE, markersize=4, label=f"B, palm {PALMS[0]}'s hinge")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title="the palms, darker is later")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)


def _hinge(angles: FloatArray, geometry: RigGeometry) -> FloatArray:
    """Position of the hinge between the palms at each pair of angles (rad): x, y (mm, world frame)."""
    return np.array([geometry.hinge(first) for first, *_ in angles]) * 1e3


def _arm_point(angles: FloatArray, geometry: RigGeometry) -> FloatArray:
    """Position of the point held by the arm at each pair of angles (rad): x, y (mm, world frame)."""
    phi12 = angles.sum(axis=1)
    reach = geometry.palm_lengths[-1] * 1e3 * np.column_stack((np.cos(phi12), np.sin(phi12)))
    return _hinge(angles, geometry) + reach


def _corners(limits: MotionLimits) -> FloatArray:
    """The boundary of the angles (rad) that the configured limits permit."""
    (low1, high1), (low2, high2) = limits.angles
    up, across = np.linspace(0.0, 1.0, _EDGE), np.linspace(low1, min(high1, limits.top - low2), _EDGE)
    top = np.minimum(high2, limits.top - across)
    first = np.column_stack((np.full(_EDGE, across[0]), low2 + up * (top[0] - low2)))
    last = np.column_stack((np.full(_EDGE, across[-1]), top[-1] + up * (low2 - top[-1])))
    back = np.column_stack((across[::-1], np.full(_EDGE, low2)))
    return np.vstack((first, np.column_stack((across, top)), last, back))


def _draw_limit_usage(axes: Axes, used: list[LimitUsage]) -> None:
    """Draw the used fraction of each limit, the most used on top."""
    for number, each in enumerate(used):
        colour = ORANGE if each.share > _NEAR else BLUE
        axes.barh(number, min(each.share, 1.2), color=colour, height=0.7)
    axes.axvline(1.0, color=GREY, linestyle=_DOTTED)
    axes.set_yticks(range(len(used)), [each.text() for each in used])
    axes.set_ylim(len(used) - 0.5, -0.5)
    axes.set_xlim(0.0, 1.05)
    axes.xaxis.set_major_formatter(lambda share, _: f"{100 * share:.0f} %")
    axes.grid(axis="y", visible=False)
    axes.set_title("usage of the limits (the arm's internal limits are not known here)", loc="right")
