"""What chapter 4 of CMU-CS-01-107 can observe: rank and conditioning of its codistributions at random states."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from palmd.console.arguments import count, seed
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import missing, only_without
from tools.studies.codistributions import GRAVITY_M_S2, LENGTH_M, RankVerdict, judged, random_states

EQUATIONS = {
    "general": "(4.25)-(4.35)",
    "equal rates": "(4.36)-(4.46)",
    "palm 1 fixed": "(4.47)-(4.57)",
    "palms fixed": "(4.58)-(4.66)",
    "palms fixed, with inputs": "(4.67), (4.68)",
}
NOTES = (
    "scaled: lengths in {length:g} mm, times in {time:.0f} ms = √(length/g), each differential to length 1",
    "general: zero where d1² (ρ²−d2²) (ω1−ω0) = d2² (ρ²−d1²) (ω12−ω0), so wherever d1 = d2 = 0 (a circle)",
    "equal rates (4.46): zero where ω0 = 0, ω1 = 0 or sin φ1 = 0",
    "palm 1 fixed (4.57): zero where ω0 = 0, ω2 = 0 or its bracket is zero, a surface through ordinary states",
    "palms fixed: rank 4 by the drift alone, at every state; the inputs make up for it",
    "all of them are infinite where the object turns with a palm: ω0 = ω1 or ω0 = ω12",
)
_HEAD = ("case", "equations", "size", "rank", "observable", "full rank at", "smallest σ", "condition")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add = parser.add_argument
    add("--states", type=count, default=2000, metavar="N", help="how many random states (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="SEED", help="of the states (default: %(default)s)")
    add("-o", "--output", type=Path, metavar="FOLDER", help="also draw maps over the rates: observability.svg")


def run(arguments: argparse.Namespace) -> int:
    """Prints the table; CliError when the figure is asked for and cannot be drawn."""
    maps = _maps() if arguments.output else None
    if maps:
        _writable(arguments.output / maps.NAME)
    print(table(judged(random_states(arguments.states, arguments.seed))))
    print(f"medians over {arguments.states} random states, seed {arguments.seed}")
    for line in NOTES:
        print(line.format(length=LENGTH_M * 1e3, time=math.sqrt(LENGTH_M / GRAVITY_M_S2) * 1e3))
    if maps:
        print(f"written: {maps.save(arguments.output)}")
    return 0


def table(verdicts: Sequence[RankVerdict]) -> str:
    """A line a case; ∞ where the rank is short."""
    lines = [_HEAD, *map(_cells, verdicts)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(_HEAD))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )


def _cells(verdict: RankVerdict) -> tuple[str, ...]:
    return (
        verdict.case,
        EQUATIONS[verdict.case],
        f"{verdict.functions} × {verdict.states}",
        str(verdict.rank),
        "yes" if verdict.observable else "no",
        f"{verdict.full:.2%}",
        f"{verdict.smallest:.1e}",
        f"{verdict.condition:.1e}" if math.isfinite(verdict.condition) else "∞",
    )


def _maps() -> ModuleType:
    """The module that draws, loaded before anything is computed; CliError without matplotlib."""
    try:
        from tools.studies import observability_maps
    except ModuleNotFoundError as error:
        only_without("matplotlib", error)
        raise missing("-o", "matplotlib", "studies") from None
    return observability_maps


def _writable(path: Path) -> None:
    """CliError when `path` cannot be written; what is there stays for now."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("ab").close()
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: cannot be written: {error.strerror or error}") from None
