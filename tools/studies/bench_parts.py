"""What better or worse parts would do to the outline: its bound for other noise, play and rates."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palmd.console.arguments import count, seconds, seed
from palmd.console.columns import aligned
from palmd.console.configured import configured
from palmd.console.shipped import shipped
from palmd.rig.shapes import KINDS
from tools.studies.parts import LOOKED_AT, PartsRow, rows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("config", nargs="?", type=Path, default=shipped("tabletop.yaml"), help="the rig; default: strips and servos")
    add("--runs", type=count, default=8, metavar="N", help="how many objects (default: %(default)s)")
    add("--kind", choices=KINDS, default="rig", help="what sort of object (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first object's (default: %(default)s)")
    add("--seconds", type=seconds, default=10.0, metavar="S", help="how long each run is (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Prints the table; CliError for a configuration that cannot be used."""
    config = configured(arguments.config)
    seeds = range(arguments.seed, arguments.seed + arguments.runs)
    made = list(rows(config, arguments.kind, seeds, arguments.seconds))
    print(f"seeds {seeds[0]} to {seeds[-1]}, {arguments.seconds:g} s each; medians of one-sigma bounds where touched")
    print(table(made))
    return 0


def table(made: Sequence[PartsRow]) -> str:
    """A line for each rig."""
    lines: list[tuple[str, Sequence[str]]] = [("", ("outline RMS", "largest", "ρ"))]
    for parts in LOOKED_AT:
        mine = [row for row in made if row.parts == parts]
        h, most, rho = (np.median([getattr(row, name) for row in mine]) for name in ("h_sd_m", "h_most_m", "rho_share"))
        lines.append((parts.name, (f"{h * 1e6:.0f} µm", f"{most * 1e6:.0f} µm", f"{rho:.1%}")))
    return aligned(lines)
