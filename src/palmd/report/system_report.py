"""The report of a run of a system with its own quantity tables: its own sections, then those common to all systems."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from palmd.report import texts
from palmd.report.findings import verdict_of
from palmd.report.loop_figure import draw_loop
from palmd.report.motion_figure import bar_rows
from palmd.report.sections import CaptionedFigure, Listing, Report, Section, verdict_sections
from palmd.report.series import Series
from palmd.report.system_figure import actuators, draw_actuators, draw_estimate, drawn_quantities

_PANEL_IN = 1.25


def system_report(series: Series, own: Sequence[Section]) -> Report:
    """The system's `own` sections first; sections without data are omitted."""
    quantities = drawn_quantities(series)
    state = CaptionedFigure(
        partial(draw_estimate, series=series, quantities=quantities),
        _PANEL_IN * (1 + len(quantities) // 2),
        "Blue: valid estimate with its band; grey: invalid estimate; dashed: an emulated rig's truth.",
    )
    sections = [
        *own,
        Section("State", (state,)),
        Section("Motion", _motion(series)),
        Section("Loop", _loop(series)),
        Section("Faults", (texts.faults(series),)),
        Section("Log", (texts.log(series),) if series.log else ()),
        Section("Messages", (texts.topics(series),)),
        Section("Configuration", (Listing(texts.configuration(series)),)),
    ]
    verdict = verdict_of(series)
    present = tuple(section for section in (*verdict_sections(verdict), *sections) if section.parts)
    return Report(series.run.path.stem, texts.facts(series), present, verdict)


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


def _loop(series: Series) -> tuple[CaptionedFigure | texts.Table, ...]:
    if not len(series.loop.t):
        return ()
    return (
        CaptionedFigure(partial(draw_loop, series=series), 3.6, texts.loop_caption(series)),
        texts.error_counts(series),
    )
