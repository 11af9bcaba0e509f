"""Tables of measured times, and a description of the machine."""

import os
import platform
from pathlib import Path

import numpy as np

PARTS = ("p50", "p99", "p99.9", "max")


def machine():
    """One line that describes the machine."""
    cpuinfo = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    names = [line.partition(":")[2].strip() for line in cpuinfo if line.startswith("model name")]
    load = os.getloadavg()[0]
    return (
        f"{os.cpu_count()} cores ({names[0] if names else platform.machine()}), Linux {platform.release()}, "
        f"Python {platform.python_version()}, load {load:.1f}"
    )


def percentiles(values):
    """Median, 99th and 99.9th percentile (nearest rank), and maximum: one value for each of `PARTS`."""
    ordered = np.sort(values)
    return tuple(float(ordered[-(-len(ordered) * permille // 1000) - 1]) for permille in (500, 990, 999, 1000))


def show(title, columns, rows):
    """Prints a table: the first cell of a row is its name, the others are numbers or words."""
    cells = [["", *columns], *([str(row[0]), *map(_shown, row[1:])] for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(cells[0]))]
    print(f"\n{title}")
    for name, *values in cells:
        aligned = (value.rjust(width) for value, width in zip(values, widths[1:], strict=True))
        print("  " + "  ".join([name.ljust(widths[0]), *aligned]))


def _shown(value):
    return value if isinstance(value, str) else f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
