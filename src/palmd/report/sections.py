"""The report of a run: its sections in their order, each a figure, a table or a text. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from matplotlib.figure import Figure, FigureBase

from palmd.report import words
from palmd.report.axes import WIDTH_IN
from palmd.report.body import frames
from palmd.report.errors import Errors, against, body_at, errors_of, last_outlines
from palmd.report.findings import RunVerdict, verdict_of
from palmd.report.frames_figure import MOST, ROW_IN, draw_frames, rows
from palmd.report.loop_figure import draw_loop
from palmd.report.motion_figure import bar_rows, draw_motion
from palmd.report.outline_figure import Found, draw_felt, draw_outline
from palmd.report.player_data import player_data
from palmd.report.quality_figure import draw_consistency, draw_coverage, draw_forces
from palmd.report.series import Series
from palmd.report.state_figure import draw_errors, draw_state


@dataclass(frozen=True, slots=True)
class Plate:
    """A figure of `WIDTH_IN` and this height (inches), what draws it, and the sentence under it."""

    draw: Callable[[FigureBase], None]
    height_in: float
    sentence: str


@dataclass(frozen=True, slots=True)
class Listing:
    """Text whose lines stand as they are."""

    text: str


@dataclass(frozen=True, slots=True)
class Player:
    """The run to be played back where that can be, and the sentence under it; `data` as `player_data` tells it."""

    data: dict[str, Any]
    sentence: str


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what belongs under it."""

    title: str
    parts: tuple[Plate | words.Table | Listing | Player, ...]


@dataclass(frozen=True, slots=True)
class Report:
    """Title, the verdict where there is one, the facts of the title block, and the sections."""

    title: str
    facts: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    verdict: RunVerdict | None = None

    @property
    def plates(self) -> int:
        """How many figures there are to draw."""
        return sum(isinstance(part, Plate) for section in self.sections for part in section.parts)


def report_of(series: Series) -> Report:
    """Everything there is to say of a run; what it does not hold is left out, or said to be missing."""
    errors = errors_of(series)
    judged = errors if series.valid.any() else None
    verdict = verdict_of(series, judged)
    sections = [
        Section("Playback", _player(series)),
        Section("Outline", _outlines(series)),
        Section("Reconstruction through time", _frames(series)),
        Section("State", _state(series, errors, judged)),
        Section("Motion", _motion(series)),
        Section("Forces, friction and mass", _forces(series, judged)),
        Section("Consistency", _consistency(series, judged)),
        Section("Coverage", _coverage(series)),
        Section("Loop", _loop(series)),
        Section("Faults", (words.faults(series),)),
        Section("Log", (words.log(series),) if series.log else ()),
        Section("Rig", () if series.rig_off is None else (words.rig(series),)),
        Section("Messages", (words.topics(series),)),
        Section("Configuration", (Listing(words.configuration(series)),)),
    ]
    told = tuple(section for section in (*verdict_sections(verdict), *sections) if section.parts)
    return Report(series.run.path.stem, words.facts(series), told, verdict)


def verdict_sections(verdict: RunVerdict) -> tuple[Section, ...]:
    """What was found, and the tests."""
    return (
        Section("Findings", (words.findings(verdict),)),
        Section("Test ratios", (words.ratios(verdict),) if verdict.ratios else ()),
    )


def drawn(plate: Plate) -> Figure:
    """The plate as a figure of its own; to be called and saved within `run_axes.styled`."""
    figure = Figure(figsize=(WIDTH_IN, plate.height_in), layout="constrained")
    plate.draw(figure)
    return figure


def _player(series: Series) -> tuple[Player, ...]:
    data = player_data(series)
    return () if data is None else (Player(data, words.under_player(series)),)


def _outlines(series: Series) -> tuple[Plate, ...]:
    outlines = last_outlines(series)
    if not outlines:
        return (Plate(partial(draw_felt, series=series), 3.2, words.under_felt(series)),) if series.valid.any() else ()
    plates = []
    for outline in outlines:
        body = body_at(series, outline.t)
        found = Found(outline, None if body is None else against(outline, body))
        plates.append(Plate(partial(draw_outline, found=found), 5.4, words.under_outline(series, outline)))
    return tuple(plates)


def _frames(series: Series) -> tuple[Plate, ...]:
    numbers = frames(series, MOST)
    if not numbers:
        return ()
    said = words.under_frames(series, numbers)
    return (Plate(partial(draw_frames, series=series), ROW_IN * rows(series), said),)


def _state(series: Series, errors: Errors | None, judged: Errors | None) -> tuple[Plate, ...]:
    state = Plate(partial(draw_state, series=series, errors=errors), 7.4, words.under_state(series))
    if judged is None:
        return (state,)
    said = words.under_errors(series, judged)
    return (state, Plate(partial(draw_errors, series=series, errors=judged), 7.4, said))


def _forces(series: Series, judged: Errors | None) -> tuple[Plate, ...]:
    if not series.valid.any():
        return ()
    said = words.under_forces(series, judged)
    return (Plate(partial(draw_forces, series=series, errors=judged), 3.4, said),)


def _consistency(series: Series, judged: Errors | None) -> tuple[Plate, ...]:
    height = 3.2 if judged is None else 4.4
    said = words.under_consistency(series, judged)
    return (Plate(partial(draw_consistency, series=series, errors=judged), height, said),)


def _motion(series: Series) -> tuple[Plate | words.Table, ...]:
    if not len(series.motion.t):
        return ()
    height = 4.6 + 0.24 * bar_rows(series)
    return (Plate(partial(draw_motion, series=series), height, words.under_motion(series)), words.spent(series.states))


def _coverage(series: Series) -> tuple[Plate, ...]:
    if not series.outlines:
        return ()
    return (Plate(partial(draw_coverage, series=series), 2.6, words.under_coverage(series)),)


def _loop(series: Series) -> tuple[Plate | words.Table, ...]:
    if not len(series.loop.t):
        return ()
    plate = Plate(partial(draw_loop, series=series), 3.6, words.under_loop(series))
    return (plate, words.discarded(series))
