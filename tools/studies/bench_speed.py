"""How fast palmd is here, as ratios to references that take turns with it in the same run: of processor time."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import chain

from palmd.console.arguments import count, seconds
from palmd.console.columns import aligned
from palmd.console.progress import Progress
from tools.studies.speed import Contest, Figure, figure, kernels, records, routines, starts, ticks

TURNS = 7


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--turns", type=count, default=TURNS, metavar="N", help="of each, and its reference (default: %(default)s)")
    add(
        "--records", type=seconds, nargs="*", default=[10.0, 40.0], metavar="S",
        help="whole records of so many seconds, shortest first (default: 10 40; without one: none)",
    )  # fmt: skip
    add("--markdown", action="store_true", help="as a table for docs/results/speed.md")


def run(arguments: argparse.Namespace) -> int:
    """Prints the table."""
    lengths = sorted(arguments.records)
    asked = list(chain(kernels(), routines(), ticks(), starts(), records(lengths) if lengths else ()))
    figures = list(_measured(asked, arguments.turns))
    print(markdown(figures) if arguments.markdown else table(figures))
    return 0


def _measured(asked: Sequence[Contest], turns: int) -> Iterator[Figure]:
    with Progress("measured", len(asked), "figures") as progress:
        for number, contest in enumerate(asked, 1):
            yield figure(contest, min(turns, 3) if contest.once else turns)
            progress.at(number)


HEAD = ("palmd", "reference", "its time", "ratio", "worst", "goal")


def table(figures: Sequence[Figure]) -> str:
    """A line for each figure, with what stands beside it."""
    return aligned([("", HEAD), *((each.name, _cells(each)) for each in figures)])


def markdown(figures: Sequence[Figure]) -> str:
    """The same as a table in Markdown."""
    rows = [("", *HEAD), tuple("---" for _ in range(len(HEAD) + 1)), *((each.name, *_cells(each)) for each in figures)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _cells(told: Figure) -> tuple[str, ...]:
    goal = "" if told.goal is None else f"{told.goal:g}" + ("" if told.met else " not met")
    return time_of(told.ours), told.beside, time_of(told.theirs), f"{told.ratio:.2f}", f"{told.worst:.2f}", goal


def time_of(value_s: float) -> str:
    """A time (s) in the unit that it is best read in."""
    scale, unit = next((each for each in ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")) if value_s >= each[0]), (1e-9, "ns"))
    return f"{value_s / scale:.3g} {unit}"
