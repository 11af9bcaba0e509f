"""Dice, nuts, coins and blocks on the emulated rig: how often a live estimate is valid and wrong; prints the seeds."""

from __future__ import annotations

import argparse

from palmd.console.arguments import count, seconds, seed
from palmd.lab import things
from palmd.lab.bench_montecarlo import ALL
from palmd.lab.rows import collected, on_this_machine
from palmd.rig.simulate import CALIBRATION


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=10, metavar="N", help="how many of each kind (default: %(default)s)")
    add("--kind", choices=(*things.KINDS, ALL), default=ALL, help="what lies on the palms (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds, default=15.0, metavar="S", help="how long each lasts (default: %(default)s)")
    add(
        "--imperfections",
        choices=tuple(CALIBRATION),
        default="none",
        help="what the rig is off by, drawn by the seed (default: %(default)s)",
    )
    add("--jobs", type=count, metavar="J", help="processes on this machine (default: one a processor)")


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it tells of what is finished until then."""
    kinds = things.KINDS if arguments.kind == ALL else (arguments.kind,)
    tasks = things.tasks_of(kinds, arguments.seed, arguments.runs, arguments.seconds, arguments.imperfections)
    finished, status = collected("things", tasks, things.run, things.failed, on_this_machine(arguments.jobs))
    rows = sorted(finished, key=lambda row: (things.KINDS.index(row.kind), row.seed))
    print(f"seeds {arguments.seed} to {arguments.seed + arguments.runs - 1}")
    if rows:
        print(things.table(rows))
    for remark in things.remarks(rows):
        print(remark)
    return status
