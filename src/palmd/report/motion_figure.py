"""Figure of commanded and actual palm angles, states and faults; needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch

from palmd.quantities import MOTION
from palmd.report.axes import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    bars,
    dashed_line,
    in_view,
    legend_above,
    line,
    over_time,
)
from palmd.report.series import Interval, Series
from palmd.system.mechanism import PALMS

STATES = {
    "idle": "#d9d9d9", "ready": "#56b4e9", "tracking": GREEN, "hold": "#e69f00", "fault": ORANGE, "stopping": "#f0e442",
    "e-stop": BLACK, "power off": GREY, "manual": PINK, "uncalibrated": "#b3b3b3",
}  # fmt: skip
ARM_STATES = {"R": "ready", "T": "tracking", "H": "hold", "D": "stopping", "F": "fault", "X": "e-stop",
    "P": "power off", "M": "manual", "U": "uncalibrated"}  # fmt: skip
SEVERITIES = {"note": "#9ecae1", "degrade": "#fdae61", "hold": "#d6604d", "stop": "#67001f"}
_MAX_FAULTS = 12
_SEGMENT_COLOURS = (BLUE, "#56b4e9")  # alternating


def bar_rows(series: Series) -> int:
    """Number of rows of bars."""
    return 3 + min(len({fault.code for fault in series.faults}), _MAX_FAULTS)


def draw_motion(figure: FigureBase, series: Series) -> None:
    """Draw angles and following errors, and below states and faults as bars."""
    count = bar_rows(series)
    grid = figure.subplots(4, 1, sharex=True, height_ratios=(1.3, 1.3, 1.0, 0.24 * count))
    for axes, palm in zip(grid, PALMS, strict=False):
        t = series.motion.t
        commanded, actual = (np.degrees(series.motion[f"phi{palm}{infix}_rad"]) for infix in ("_cmd", ""))
        line(axes, t, actual, color=BLUE, linewidth=1.2, label="actual")
        dashed_line(axes, t, commanded, "commanded")
        line(grid[2], t, actual - commanded, color=(BLUE, ORANGE)[palm - 1], linewidth=0.7, label=f"palm {palm}")
        in_view(axes, actual, commanded, least=1.0)
        axes.set_ylabel(MOTION[f"phi{palm}_rad"].label)
    legend_above(grid[0], 2)
    grid[2].set_ylabel("actual −\ncommanded (°)")
    grid[2].legend(loc="upper right", ncols=2)
    draw_states(figure, grid, series)


def draw_states(figure: FigureBase, grid: Sequence[Axes], series: Series) -> None:
    """Draw states and faults as bars in the last of the panels, and the time axis and legend of all."""
    segments = tuple(
        Interval(str(number % 2), interval.begin, interval.end)
        for number, interval in enumerate(interval for interval in series.segments if interval.label)
    )
    arm = tuple(
        Interval(ARM_STATES.get(interval.label, ""), interval.begin, interval.end) for interval in series.arm_states
    )
    codes = list(dict.fromkeys(fault.code for fault in series.faults))[:_MAX_FAULTS]
    faults = [
        (
            code,
            [Interval(f"fault: {each.severity}", each.begin, each.end) for each in series.faults if each.code == code],
        )
        for code in codes
    ]
    colours = STATES | {f"fault: {name}": colour for name, colour in SEVERITIES.items()}
    rows = [("palmd", series.states), ("arm", arm), ("segment", segments), *faults]
    bars(grid[-1], rows, colours | dict(zip("01", _SEGMENT_COLOURS, strict=True)))
    for axes in grid:
        over_time(axes, series, last=axes is grid[-1])
    occurring = {interval.label for _, spans in rows for interval in spans}
    key = [Patch(color=colour, label=name) for name, colour in colours.items() if name in occurring]
    if key:
        figure.legend(handles=key, loc="outside lower center", ncols=6)
