"""Curved palms: cradles and domes reconstructed blind, moved, explored, and how much more of an outline they touch."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from palmd.console.arguments import count, seconds, seed
from palmd.console.extras import drawing
from palmd.rig.simulate_curved import CURVED_KINDS
from tools.studies import curved, curved_coverage, curved_exploring
from tools.studies.curved_exploring import CradleRow, CradleTask
from tools.studies.rows import Sink, collected, on_this_machine


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=34, metavar="N", help="logs of each kind (default: %(default)s)")
    add("--shapes", type=count, default=60, metavar="N", help="objects on each curvature (default: %(default)s)")
    add(
        "--objects",
        type=count,
        default=12,
        metavar="N",
        help="objects to explore, or to move at random (default: %(default)s)",
    )
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds, default=10.0, metavar="S", help="how long a log is (default: %(default)s)")
    add("--only", choices=tuple(_PARTS), help="one part of it; default: all")
    add("--figure", type=Path, metavar="OUT.svg", help="draw the touched share against curvature; needs matplotlib")
    add("-o", "--output", type=Path, metavar="ROWS", help="a file of JSON lines for the explorations, overwritten")
    add("--jobs", type=count, metavar="J", help="processes on this machine (default: one a processor)")


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it tells of what is finished until then."""
    for part in [arguments.only] if arguments.only else _PARTS:
        status = _PARTS[part](arguments)
        if status:
            return status
    return 0


def _logs(arguments: argparse.Namespace) -> int:
    seeds = range(arguments.seed, arguments.seed + arguments.runs)
    tasks = [curved.LogTask(kind, each, arguments.seconds) for each in seeds for kind in CURVED_KINDS]
    workers = on_this_machine(arguments.jobs)
    rows, status = collected("curved", tasks, curved.reconstructed, curved.log_failed, workers)
    order = sorted(rows, key=lambda row: (CURVED_KINDS.index(row.kind), row.seed))
    print(f"reconstructed, seeds {seeds[0]}–{seeds[-1]} of each kind")
    print(curved.log_table(order))
    for row in order:
        if row.error or not row.converged:
            print(f"{row.kind} {row.seed}: {row.error or row.reason}")
    return status


def _coverage(arguments: argparse.Namespace) -> int:
    objects = curved_coverage.objects(arguments.shapes, arguments.seed)
    print(f"share of the normals touched, {arguments.shapes} objects, seeds from {arguments.seed}")
    rows = [curved_coverage.covered(kappa, objects) for kappa in curved_coverage.curvatures()]
    print(curved_coverage.table(rows))
    if arguments.figure is not None and (figures := drawing("tools.studies.outlook_figures")):
        figures.save_coverage(rows, arguments.figure)
    return 0


def _plans(arguments: argparse.Namespace) -> int:
    tasks = curved_exploring.plans_of(arguments.seed, arguments.objects, curved_exploring.PLAN_S)
    return _ran(arguments, tasks, "moved at random", curved_exploring.plan_table)


def _exploring(arguments: argparse.Namespace) -> int:
    tasks = curved_exploring.tasks_of(arguments.seed, arguments.objects, curved_exploring.MOST_S)
    return _ran(arguments, tasks, "explored", curved_exploring.table)


def _ran(
    arguments: argparse.Namespace,
    tasks: Sequence[CradleTask],
    what: str,
    table: Callable[[Sequence[CradleRow]], str],
) -> int:
    sink = None if arguments.output is None else Sink(arguments.output, curved_exploring.as_line)
    rows, status = collected(
        what, tasks, curved_exploring.run, curved_exploring.failed, on_this_machine(arguments.jobs), sink
    )
    if rows:
        print(f"{what}, seeds from {arguments.seed}")
        print(table(rows))
        for remark in curved_exploring.remarks(rows):
            print(remark)
    return status


_PARTS: Mapping[str, Callable[[argparse.Namespace], int]] = {
    "logs": _logs,
    "coverage": _coverage,
    "plans": _plans,
    "exploring": _exploring,
}
