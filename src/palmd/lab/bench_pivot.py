"""The pivoting grasp reconstructed blind from simulated runs: outline about the pivot, friction, and their bands.

Right is an outline within 0.1 mm (RMS) of the truth where it was touched, after the best rotation. Runs of the rigid
gripper (tilt) and of the slide (float) are drawn by their seeds; `--trouble` spoils the readings.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.console.arguments import count, seconds, seed
from palmd.lab import pivot, workers
from palmd.lab.bench_montecarlo import ALL
from palmd.lab.pivot import TROUBLES, PivotRow, PivotTask, as_line, report
from palmd.lab.rows import Sink, collected
from palmd.rig.pivot import PIVOT_KINDS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=100, metavar="N", help="how many of each kind (default: %(default)s)")
    add("--kind", choices=(*PIVOT_KINDS, ALL), default=ALL, help="what sort of run (default: %(default)s)")
    add("--trouble", choices=tuple(TROUBLES), default="none", help="with the readings (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds, default=12.0, metavar="S", help="how long each lasts (default: %(default)s)")
    add("-o", "--output", type=Path, default=Path("pivot.jsonl"), metavar="FILE",
        help="a JSON line for each run (default: %(default)s)")  # fmt: skip
    workers.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it ends with what is finished until then; CliError when it cannot begin."""
    kinds = PIVOT_KINDS if arguments.kind == ALL else (arguments.kind,)
    tasks = [
        PivotTask(kind, number, arguments.seconds, arguments.trouble)
        for kind in kinds
        for number in range(arguments.seed, arguments.seed + arguments.runs)
    ]
    path: Path = arguments.output
    workers_asked = workers.asked_for(arguments)
    rows, status = collected(
        "pivoting grasp", tasks, pivot.run, pivot.failed, workers_asked, Sink[PivotRow](path, as_line)
    )
    if rows:
        print(f"seeds {arguments.seed}–{arguments.seed + arguments.runs - 1}, {arguments.seconds:g} s each")
        print(report(rows))
        for row in rows:
            if not row.converged:
                print(f"{row.kind} {row.seed}: {row.reason}")
        print(f"written: {path}")
    return status
