"""The pivoting grasp reconstructed blind from simulated runs: outline about the pivot, friction, and their bands.

Right is an outline within 0.1 mm (RMS) of the truth where it was touched, after the best rotation. Runs of the rigid
gripper (tilt) and of the slide (float) are drawn by their seeds; `--trouble` spoils the readings. With `--live` the
daemon's core explores emulated rigs in closed loop without wires, and what it claims on the way is scored. A file that
has live runs already is gone on with: the same command with more runs does those that are not there yet, and tells of
all.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.config.two_palms import Drawn
from palmd.console.arguments import count, seconds, seconds_within, seed
from palmd.rig.pivot import LEAST_S, PIVOT_KINDS
from tools.studies import pivot, pivot_live, workers
from tools.studies.bench_montecarlo import ALL
from tools.studies.pivot import TROUBLES, PivotRow, PivotTask, report
from tools.studies.pivot_live import LiveRow
from tools.studies.rows import Sink, already_in, collected, rewrite
from tools.studies.scoring import as_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=100, metavar="N", help="how many of each kind (default: %(default)s)")
    add("--kind", choices=(*PIVOT_KINDS, ALL), default=ALL, help="what sort of run (default: %(default)s)")
    add("--trouble", choices=tuple(TROUBLES), default="none", help="with the readings (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds_within(LEAST_S, 120.0), default=12.0, metavar="S",
        help="how long each lasts (default: %(default)s)")  # fmt: skip
    add("--live", action="store_true", help="explore in closed loop and score what is claimed live")
    add("--slide", action="store_true", help="live: with a gripper on a slide")
    add("--perfect", action="store_true", help="live: on rigs exactly as configured, which is known")
    add("--period", type=seconds, default=5.0, metavar="S",
        help="live: how often the smoother is begun (default: %(default)s)")  # fmt: skip
    add("-o", "--output", type=Path, metavar="FILE",
        help="a JSON line for each run (default: pivot.jsonl, live pivot-live.jsonl)")  # fmt: skip
    workers.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it ends with what is finished until then; CliError when it cannot begin."""
    if arguments.live:
        return _live(arguments)
    kinds = PIVOT_KINDS if arguments.kind == ALL else (arguments.kind,)
    tasks = [
        PivotTask(kind, number, arguments.seconds, arguments.trouble)
        for kind in kinds
        for number in range(arguments.seed, arguments.seed + arguments.runs)
    ]
    path: Path = arguments.output or Path("pivot.jsonl")
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


def _live(arguments: argparse.Namespace) -> int:
    path: Path = arguments.output or Path("pivot-live.jsonl")
    rows = {row.task: row for row in already_in(path, pivot_live.row_from)}
    seeds = range(arguments.seed, arguments.seed + arguments.runs)
    off: Drawn = "none" if arguments.perfect else "calibrated"
    tasks = pivot_live.tasks_of(off, arguments.period, "float" if arguments.slide else "rigid", seeds, rows)
    finished, status = collected(
        "pivoting grasp, live", tasks, pivot_live.run, pivot_live.failed, workers.asked_for(arguments),
        Sink[LiveRow](path, as_line, append=True),
    )  # fmt: skip
    rows |= {row.task: row for row in finished}
    if rows:
        ordered = sorted(rows.values(), key=lambda row: (row.task.name, row.task.seed))
        rewrite(path, map(as_line, ordered))
        print(f"seeds {', '.join(sorted({str(row.task.seed) for row in ordered}, key=int))}")
        print(pivot_live.report(ordered))
        for row in ordered:
            if not row.right or row.wrong_claim:
                print(pivot_live.remark(row))
        print(f"written: {path}")
    return status
