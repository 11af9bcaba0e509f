"""A run's report as PDF on A4 with vector figures and embedded fonts. Needs matplotlib."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from palmd.report import texts
from palmd.report.axes import WIDTH_IN, figure_style
from palmd.report.sections import CaptionedFigure, Player, Report
from palmd.report.texts import Table

_PAGE_IN = (8.27, 11.69)
_SIDE_IN, _TOP_IN = (_PAGE_IN[0] - WIDTH_IN) / 2, 0.75
_ROOM_IN = _PAGE_IN[1] - 2 * _TOP_IN
_CAPTION_IN, _HEADING_IN, _BETWEEN_IN = 0.17, 0.35, 0.2  # heights of a caption line, a heading, the space below a block
_LETTERS, _LINE_IN = 108, 0.13  # characters in a line of text, and its height
_WORDS = 108  # characters in a line of a caption


@dataclass(frozen=True, slots=True)
class _PageBlock:
    """A part kept together on a page: an optional heading, then a figure with its caption, or lines of text."""

    heading: str
    figure_part: CaptionedFigure | None
    number: int
    lines: tuple[str, ...]

    @property
    def height_in(self) -> float:
        inner = len(self.lines) * _LINE_IN
        if self.figure_part is not None:
            inner = self.figure_part.height_in + len(self.lines) * _CAPTION_IN
        return (_HEADING_IN if self.heading else 0.0) + inner + _BETWEEN_IN


def as_pdf(report: Report, at: Callable[[int], None] = lambda _: None) -> bytes:
    """The file; equal reports give equal bytes. `at` is called with the number of figures drawn."""
    file = BytesIO()
    with (
        figure_style(),
        PdfPages(file, metadata={"Title": f"palmd: {report.title}", "CreationDate": None}) as pages,
    ):
        for blocks in _pages(list(_blocks(report))):
            pages.savefig(_page(blocks))
            at(max(block.number for block in blocks))
    return file.getvalue()


def _blocks(report: Report) -> Iterator[_PageBlock]:
    number = 0
    width = max(len(name) for name, _ in report.facts)
    facts = [line for name, value in report.facts for line in _wrapped(value, f"{name:{width}}  ")]
    verdict = [] if report.verdict is None else [*_wrapped(texts.verdict(report.verdict), ""), ""]
    yield _PageBlock(report.title, None, 0, (*verdict, *facts))
    for section in report.sections:
        heading = section.title
        for part in section.parts:
            if isinstance(part, Player):  # not possible on paper
                continue
            if isinstance(part, CaptionedFigure):
                number += 1
                caption = textwrap.wrap(f"Figure {number}. {part.caption}", _WORDS)
                yield _PageBlock(heading, part, number, tuple(caption))
            else:
                lines = _rows(part) if isinstance(part, Table) else part.text.splitlines()
                for some in _chunks([piece for line in lines for piece in _wrapped(line, "")]):
                    yield _PageBlock(heading, None, number, some)
                    heading = ""
            heading = ""


def _chunks(lines: Sequence[str]) -> Iterator[tuple[str, ...]]:
    most = int((_ROOM_IN - _HEADING_IN - _BETWEEN_IN) / _LINE_IN)
    for begin in range(0, len(lines), most):
        yield tuple(lines[begin : begin + most])


def _rows(table: Table) -> list[str]:
    """The rows as text in columns; the last column is wrapped."""
    if not table.rows:
        return ["None."]
    rows = (table.head, *table.rows)
    widths = [max(map(len, column)) for column in zip(*(row[:-1] for row in rows), strict=True)]
    return [
        line
        for *before, last in rows
        for line in _wrapped(last, "".join(f"{cell:{width}}  " for cell, width in zip(before, widths, strict=True)))
    ]


def _wrapped(text: str, before: str) -> list[str]:
    """Wrap to lines of at most `_LETTERS` characters, the first after the prefix `before`, the others indented."""
    indent = " " * (len(before) or len(text) - len(text.lstrip()) + 2)
    return textwrap.wrap(
        before + text, _LETTERS, subsequent_indent=indent, drop_whitespace=True, replace_whitespace=False
    ) or [""]


def _pages(blocks: Sequence[_PageBlock]) -> Iterator[list[_PageBlock]]:
    page: list[_PageBlock] = []
    left = _ROOM_IN
    for block in blocks:
        if page and block.height_in > left:
            yield page
            page, left = [], _ROOM_IN
        page.append(block)
        left -= block.height_in
    yield page


def _page(blocks: Sequence[_PageBlock]) -> Figure:
    figure = Figure(figsize=_PAGE_IN, layout="constrained")
    rest = max(_PAGE_IN[1] - _TOP_IN - sum(block.height_in for block in blocks), 0.01)
    heights = [_TOP_IN, *(part for block in blocks for part in _heights(block)), rest]
    grid = figure.add_gridspec(len(heights), 3, width_ratios=(_SIDE_IN, WIDTH_IN, _SIDE_IN), height_ratios=heights,
                               hspace=0.0, wspace=0.0)  # fmt: skip
    for number, block in enumerate(blocks):
        top = 1 - (_TOP_IN + sum(each.height_in for each in blocks[:number])) / _PAGE_IN[1]
        left = _SIDE_IN / _PAGE_IN[0]
        if block.heading:
            figure.text(left, top, block.heading, fontsize=12.0, fontweight="bold", va="top")
        if block.figure_part is not None:
            block.figure_part.draw(figure.add_subfigure(grid[2 + 3 * number, 1]))
        top -= (
            (_HEADING_IN if block.heading else 0.0) + (block.figure_part.height_in if block.figure_part else 0.0)
        ) / _PAGE_IN[1]
        style = {"fontsize": 8.5} if block.figure_part else {"fontsize": 7.5, "family": "monospace"}
        figure.text(left, top, "\n".join(block.lines), va="top", linespacing=1.25, **style)
    return figure


def _heights(block: _PageBlock) -> tuple[float, float, float]:
    """Heights of a block's heading, its figure, and the rest."""
    heading = _HEADING_IN if block.heading else 0.001
    inner = block.figure_part.height_in if block.figure_part else 0.001
    return heading, inner, block.height_in - heading - inner
