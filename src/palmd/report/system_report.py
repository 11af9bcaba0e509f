"""The report of a run of a system with its own quantity tables; needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from palmd.report import texts
from palmd.report.motion_figure import bar_rows
from palmd.report.sections import CaptionedFigure, Report, Section, assembled
from palmd.report.series import Series
from palmd.report.system_figure import actuators, draw_actuators, draw_estimate, drawn_quantities

_PANEL_IN = 1.25


def system_report(series: Series, own: Sequence[Section]) -> Report:
    """The system's `own` sections, then its state and motion; sections without data are omitted."""
    quantities = drawn_quantities(series)
    state = CaptionedFigure(
        partial(draw_estimate, series=series, quantities=quantities),
        _PANEL_IN * (1 + len(quantities) // 2),
        "Blue: valid estimate with its band; grey: invalid estimate; dashed: an emulated rig's truth.",
    )
    return assembled(series, [*own, Section("State", (state,)), Section("Motion", _motion(series))])


def _motion(series: Series) -> tuple[CaptionedFigure | texts.Table, ...]:
    if not len(series.motion.t):
        return ()
    row_count = bar_rows(series)
    height = 0.6 + 1.3 * len(actuators(series)) + 0.24 * row_count
    caption = "Commanded and actual positions of the actuators; below, states and faults."
    return (
        CaptionedFigure(partial(draw_actuators, series=series, row_count=row_count), height, caption),
        texts.durations(series.states),
    )
