"""Which of twenty similar objects lies on the emulated palms, or none of them: how often it is said right, how soon."""

from __future__ import annotations

import argparse
import os
import sys

from palmd.cli import INTERRUPTED
from palmd.cli.bench_montecarlo import ALL, count, seconds, seed
from palmd.cli.progress import Progress
from palmd.rig.shapes import KINDS
from palmd.study import recognition, runs
from palmd.study.recognition import Row, remarks, table


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
    finished: list[Row] = []
    status = 0
    try:
        with (
            runs.local(arguments.jobs or os.cpu_count() or 1) as executor,
            Progress("recognition", len(tasks), "runs") as progress,
        ):
            for row in runs.finished(executor, recognition.run, recognition.failed, tasks):
                finished.append(row)
                progress.at(len(finished))
    except KeyboardInterrupt:
        print(f"interrupted: {len(finished)} of {len(tasks)} runs are finished", file=sys.stderr)
        status = INTERRUPTED
    rows = sorted(finished, key=lambda row: (KINDS.index(row.kind), row.seed))
    if rows:
        print(table(rows))
    for remark in remarks(rows):
        print(remark)
    return status
