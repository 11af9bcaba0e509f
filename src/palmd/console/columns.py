"""Tables of numbers for a terminal. Pure."""

from __future__ import annotations

from collections.abc import Sequence


def aligned(lines: Sequence[tuple[str, Sequence[str]]]) -> str:
    """Format lines of a name and equally many cells: names left-aligned, cells right-aligned."""
    widths = [max(map(len, column)) for column in zip(*(cells for _, cells in lines), strict=True)]
    first = max(len(name) for name, _ in lines)
    return "\n".join(
        "  ".join([name.ljust(first), *(cell.rjust(width) for cell, width in zip(cells, widths, strict=True))])
        for name, cells in lines
    )
