"""The report of a run of a system that has tables of its own: what all have, after what each draws itself."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from palmd.report import words
from palmd.report.findings import verdict_of
from palmd.report.loop_figure import draw_loop
from palmd.report.motion_figure import bar_rows
from palmd.report.sections import Listing, Plate, Report, Section, verdict_sections
from palmd.report.series import Series
from palmd.report.system_figure import draw_estimate, draw_moved, estimated, moved

_PANEL_IN = 1.25


def system_report(series: Series, own: Sequence[Section]) -> Report:
    """`own` sections first; what the run does not hold is left out."""
    quantities = estimated(series)
    state = Plate(
        partial(draw_estimate, series=series, quantities=quantities),
        _PANEL_IN * (1 + len(quantities) // 2),
        "Blue: the estimate where it is valid, with its band; grey: where it is not; dashed: an emulated rig's truth.",
    )
    sections = [
        *own,
        Section("State", (state,)),
        Section("Motion", _motion(series)),
        Section("Loop", _loop(series)),
        Section("Faults", (words.faults(series),)),
        Section("Log", (words.log(series),) if series.log else ()),
        Section("Messages", (words.topics(series),)),
        Section("Configuration", (Listing(words.configuration(series)),)),
    ]
    verdict = verdict_of(series)
    told = tuple(section for section in (*verdict_sections(verdict), *sections) if section.parts)
    return Report(series.run.path.stem, words.facts(series), told, verdict)


def _motion(series: Series) -> tuple[Plate | words.Table, ...]:
    if not len(series.motion.t):
        return ()
    rows = bar_rows(series)
    height = 0.6 + 1.3 * len(moved(series)) + 0.24 * rows
    said = "What the actuators were commanded to and where they were; below, states and faults."
    return (Plate(partial(draw_moved, series=series, rows=rows), height, said), words.spent(series.states))


def _loop(series: Series) -> tuple[Plate | words.Table, ...]:
    if not len(series.loop.t):
        return ()
    return (Plate(partial(draw_loop, series=series), 3.6, words.under_loop(series)), words.discarded(series))
