"""The report of a run: its sections in order, with figures, tables and texts. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from matplotlib.figure import Figure, FigureBase

from palmd.report import texts
from palmd.report.axes import WIDTH_IN
from palmd.report.body import frames
from palmd.report.errors import Errors, body_at, errors_of, last_outlines, outline_errors
from palmd.report.findings import RunVerdict, verdict_of
from palmd.report.frames_figure import MAX_FRAMES, ROW_IN, draw_frames, row_count
from palmd.report.outline_figure import DrawnOutline, draw_contacts, draw_outline
from palmd.report.player_data import player_data
from palmd.report.series import Series
from palmd.report.time_figures import (
    draw_consistency,
    draw_coverage,
    draw_errors,
    draw_forces,
    draw_loop,
    draw_motion,
    draw_state,
    motion_height_in,
)


@dataclass(frozen=True, slots=True)
class CaptionedFigure:
    """A figure of width `WIDTH_IN` and the given height (inches), the function that draws it, and its caption."""

    draw: Callable[[FigureBase], None]
    height_in: float
    caption: str


@dataclass(frozen=True, slots=True)
class Listing:
    """Preformatted text."""

    text: str


@dataclass(frozen=True, slots=True)
class Player:
    """The run for playback in HTML, with its caption; `data` as from `player_data`."""

    data: dict[str, Any]
    caption: str


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and its contents."""

    title: str
    parts: tuple[CaptionedFigure | texts.Table | Listing | Player, ...]


@dataclass(frozen=True, slots=True)
class Report:
    """Title, facts of the title block, sections, and the verdict if there is one."""

    title: str
    facts: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    verdict: RunVerdict | None = None

    @property
    def figure_count(self) -> int:
        """Number of figures to draw."""
        return sum(isinstance(part, CaptionedFigure) for section in self.sections for part in section.parts)


def report_of(series: Series) -> Report:
    """The complete report of a run of two palms; sections without data are omitted or say what is missing."""
    errors = errors_of(series)
    valid_errors = errors if series.valid.any() else None
    state = [_figure(draw_state, 7.4, texts.state_caption(series), series, errors=errors)]
    if valid_errors is not None:
        state.append(_figure(draw_errors, 7.4, texts.errors_caption(series, valid_errors), series, errors=valid_errors))
    height_in, caption = 3.2 if valid_errors is None else 4.4, texts.consistency_caption(series, valid_errors)
    own = [
        Section("Playback", _player(series)),
        Section("Outline", _outlines(series)),
        Section("Reconstruction through time", _frames(series)),
        Section("State", tuple(state)),
        Section("Motion", motion(series, texts.motion_caption(series), differences=True)),
        Section("Forces, friction and mass", _forces(series, valid_errors)),
        Section("Consistency", (_figure(draw_consistency, height_in, caption, series, errors=valid_errors),)),
        Section("Coverage", _coverage(series)),
    ]
    return assembled(series, own, valid_errors)


def assembled(series: Series, own: Sequence[Section], errors: Errors | None = None) -> Report:
    """The report with a system's `own` sections between those common to all systems; those without data are omitted."""
    verdict = verdict_of(series, errors)
    sections = [
        Section("Findings", (texts.findings(verdict),)),
        Section("Test ratios", (texts.ratios(verdict),) if verdict.ratios else ()),
        *own,
        Section("Loop", _loop(series)),
        Section("Faults", (texts.faults(series),)),
        Section("Log", (texts.log(series),) if series.log else ()),
        Section("Rig", () if series.rig_deviations is None else (texts.rig(series),)),
        Section("Messages", (texts.topics(series),)),
        Section("Configuration", (Listing(texts.configuration(series)),)),
    ]
    present = tuple(section for section in sections if section.parts)
    return Report(series.run.path.stem, texts.facts(series), present, verdict)


def rendered(figure: CaptionedFigure) -> Figure:
    """Render a figure; to be called and saved within `axes.figure_style`."""
    canvas = Figure(figsize=(WIDTH_IN, figure.height_in), layout="constrained")
    figure.draw(canvas)
    return canvas


def _figure(
    draw: Callable[..., None], height_in: float, caption: str, series: Series, **data: object
) -> CaptionedFigure:
    """A figure of the run; `draw` gets the series and `data`."""
    return CaptionedFigure(partial(draw, series=series, **data), height_in, caption)


def _player(series: Series) -> tuple[Player, ...]:
    data = player_data(series)
    return () if data is None else (Player(data, texts.player_caption(series)),)


def _outlines(series: Series) -> tuple[CaptionedFigure, ...]:
    outlines = last_outlines(series)
    if not outlines:
        return (_figure(draw_contacts, 3.2, texts.contacts_caption(series), series),) if series.valid.any() else ()
    figures = []
    for outline in outlines:
        body = body_at(series, outline.t)
        drawn_outline = DrawnOutline(outline, None if body is None else outline_errors(outline, body))
        figures.append(
            CaptionedFigure(partial(draw_outline, drawn=drawn_outline), 5.4, texts.outline_caption(series, outline))
        )
    return tuple(figures)


def _frames(series: Series) -> tuple[CaptionedFigure, ...]:
    numbers = frames(series, MAX_FRAMES)
    if not numbers:
        return ()
    caption = texts.frames_caption(series, numbers)
    return (_figure(draw_frames, ROW_IN * row_count(series), caption, series),)


def _forces(series: Series, valid_errors: Errors | None) -> tuple[CaptionedFigure, ...]:
    if not series.valid.any():
        return ()
    caption = texts.forces_caption(series, valid_errors)
    return (_figure(draw_forces, 3.4, caption, series, errors=valid_errors),)


def motion(series: Series, caption: str, *, differences: bool = False) -> tuple[CaptionedFigure | texts.Table, ...]:
    """The figure of the motion and the duration of each state; empty without motion."""
    if not len(series.motion.t):
        return ()
    height_in = motion_height_in(series, differences=differences)
    figure = _figure(draw_motion, height_in, caption, series, differences=differences)
    return (figure, texts.durations(series.states))


def _coverage(series: Series) -> tuple[CaptionedFigure, ...]:
    if not series.outlines:
        return ()
    return (_figure(draw_coverage, 2.6, texts.coverage_caption(series), series),)


def _loop(series: Series) -> tuple[CaptionedFigure | texts.Table, ...]:
    if not len(series.loop.t):
        return ()
    figure = _figure(draw_loop, 3.6, texts.loop_caption(series), series)
    return (figure, texts.error_counts(series))
