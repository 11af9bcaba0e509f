"""Which of twenty similar objects lies on the emulated palms, or none of them: how often it is said right, how soon."""

from __future__ import annotations

import argparse

from palmd.console.arguments import count, seconds, seed
from palmd.rig.shapes import KINDS
from tools.studies import recognition
from tools.studies.bench_montecarlo import ALL
from tools.studies.recognition import remarks, table
from tools.studies.rows import collected, on_this_machine


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=50, metavar="N", help="how many of each kind (default: %(default)s)")
    add("--kind", choices=(*KINDS, ALL), default=ALL, help="what sort of run (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds, default=3.0, metavar="S", help="how long each lasts (default: %(default)s)")
    add("--jobs", type=count, metavar="J", help="processes on this machine (default: one a processor)")


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it tells of what is finished until then."""
    kinds = KINDS if arguments.kind == ALL else (arguments.kind,)
    tasks = recognition.tasks_of(kinds, arguments.seed, arguments.runs, arguments.seconds)
    finished, status = collected(
        "recognition", tasks, recognition.run, recognition.failed, on_this_machine(arguments.jobs)
    )
    rows = sorted(finished, key=lambda row: (KINDS.index(row.kind), row.seed))
    if rows:
        print(table(rows))
    for remark in remarks(rows):
        print(remark)
    return status
