"""Unknown bodies between three palms in space reconstructed blind from simulated runs, scored against their truth.

Right is a surface within 0.15 mm (RMS) of the truth within 4 degrees of where it was touched, after the best rotation.
With --exploring nothing is reconstructed: it tells which share of all directions comes within 10 degrees of a contact,
with --blind of a body of which nothing is known beforehand.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TypeVar

from palmd.console.arguments import count, seconds, seed
from palmd.console.errors import BAD_INPUT, CliError
from palmd.rig.three_palms.simulate import KINDS, simulate
from tools.studies.space import SpaceRow, reconstructed, report
from tools.studies.space_exploring import SpaceExploringRow, explored, told_of_exploring
from tools.studies.space_live import SpaceLiveRow, lived, lived_exploring, told
from tools.studies.space_live import told_of_exploring as told_blind

ALL = "all"
Row = TypeVar("Row", SpaceLiveRow, SpaceExploringRow)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=8, metavar="N", help="how many of each kind (default: %(default)s)")
    add("--kind", choices=(*KINDS, ALL), default=ALL, help="what sort of run (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="N", help="of bodies and motions (default: %(default)s)")
    add("--seconds", type=seconds, default=20.0, metavar="S", help="how long each lasts (default: %(default)s)")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--live", action="store_true", help="in the emulated rig, by the shipped plan, judged tick by tick"
    )
    how.add_argument(
        "--exploring",
        action="store_true",
        help="how much of each the palms show when the body is known to who plans, within wider limits than shipped",
    )
    add(
        "--blind",
        action="store_true",
        help="with --exploring: in the emulated rig, by the shipped plan that explores, nothing known beforehand",
    )
    add("--pace", type=float, metavar="X",
        help="with --live and --blind: answers and decisions come after X times the processor time that they take here"
        " (1.3 to 1.5: two cores of their own); default: after fixed times, the same on any machine")  # fmt: skip
    add("-o", "--output", type=Path, default=Path("space.jsonl"), metavar="FILE",
        help="a JSON line for each run (default: %(default)s)")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it ends with what is finished until then."""
    if arguments.pace is not None and not 0.0 < arguments.pace < math.inf:
        raise CliError(BAD_INPUT, f"--pace must be a number above 0, got {arguments.pace:g}")
    if arguments.pace is not None and not (arguments.live or arguments.blind):
        raise CliError(BAD_INPUT, "--pace says how --live or --exploring --blind is done: give that, too")
    if arguments.live:
        return _one_by_one(arguments, partial(lived, pace=arguments.pace), told)
    if arguments.blind and not arguments.exploring:
        raise CliError(BAD_INPUT, "--blind says how --exploring is done: give that, too")
    if arguments.blind:
        return _one_by_one(arguments, partial(lived_exploring, pace=arguments.pace), told_blind)
    if arguments.exploring:
        return _one_by_one(arguments, explored, told_of_exploring)
    kinds = tuple(KINDS) if arguments.kind == ALL else (arguments.kind,)
    rows: list[SpaceRow] = []
    path: Path = arguments.output
    try:
        with path.open("w", encoding="utf-8") as stream:
            for kind in kinds:
                for each in simulate(kind, arguments.runs, arguments.seconds, arguments.seed):
                    rows.append(reconstructed(each))
                    stream.write(json.dumps(rows[-1].line()) + "\n")
                    stream.flush()
    except KeyboardInterrupt:
        pass
    if rows:
        print(f"seed {arguments.seed}, {arguments.seconds:g} s each")
        print(report(rows))
    for row in rows:
        if not row.converged:
            print(f"{row.kind} {row.body}: {row.reason}")
    print(f"written: {path}")
    return 0


def _one_by_one(
    arguments: argparse.Namespace, row_of: Callable[[int, float], Row], lines: Callable[[list[Row]], Iterator[str]]
) -> int:
    """Runs that have a seed each; interrupted, it ends with what is finished until then."""
    rows: list[Row] = []
    path: Path = arguments.output
    with path.open("w", encoding="utf-8") as stream, contextlib.suppress(KeyboardInterrupt):
        for seed_ in range(arguments.seed, arguments.seed + arguments.runs):
            rows.append(row_of(seed_, arguments.seconds))
            stream.write(json.dumps(rows[-1].line()) + "\n")
            stream.flush()
    print("\n".join(lines(rows)))
    print(f"written: {path}")
    return 0
