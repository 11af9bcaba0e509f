"""Tables of numbers for a terminal. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence


def aligned(lines: Sequence[tuple[str, Sequence[str]]]) -> str:
    """Format lines of a name and equally many cells: names left-aligned, cells right-aligned."""
    widths = [max(map(len, column)) for column in zip(*(cells for _, cells in lines), strict=True)]
    first = max(len(name) for name, _ in lines)
    return "\n".join(
        "  ".join([name.ljust(first), *(cell.rjust(width) for cell, width in zip(cells, widths, strict=True))])
        for name, cells in lines
    )


def number(value: float, factor: float, digits: int, unit: str = "") -> str:
    """Format a value times `factor`; a dash if it is not finite."""
    return f"{value * factor:.{digits}f}{unit}" if math.isfinite(value) else "–"
