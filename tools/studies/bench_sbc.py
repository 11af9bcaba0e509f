"""Simulation-based calibration: whether blind reconstructions are as sure as they may be of what they tell.

Each run draws an imperfect rig from what calibration leaves, an object and a motion, and reconstructs ten seconds of
readings blind. Where the posterior is right the truth's rank in it is uniform: told are for each quantity the mean and
sd of z = (truth − mean)/sd, the shares within 1, 2 and 3, and how far the ranks of all claims are from uniform. Objects
are drawn from the simulator's kinds, which are narrower than what is believed of an object: a quantity that readings
hardly tell may crowd about the middle.

A file that has runs already is gone on with: the same command with more runs does those that are not there yet, and
tells of all. Files of several machines are put together with `cat`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from palmd.console.arguments import count, seconds, seed
from palmd.console.errors import BAD_INPUT, CliError
from palmd.rig.shapes import KINDS
from tools.studies import sbc, workers
from tools.studies.bench_montecarlo import ALL
from tools.studies.rows import Sink, already_in, collected, rewrite
from tools.studies.sbc import SbcRow, SbcTask, as_line, row_from
from tools.studies.sbc_summary import report


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=500, metavar="N", help="how many of each kind (default: %(default)s)")
    add("--kind", choices=(*KINDS, ALL), default=ALL, help="what sort of run (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds, default=10.0, metavar="S", help="how long each lasts (default: %(default)s)")
    add("-o", "--output", type=Path, default=Path("sbc.jsonl"), metavar="FILE",
        help="a JSON line for each run, to go on with (default: %(default)s)")  # fmt: skip
    workers.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it ends with what is finished until then; CliError when it cannot begin."""
    kinds = KINDS if arguments.kind == ALL else (arguments.kind,)
    path = arguments.output
    rows = _done(path, arguments.seconds)
    finished, status = collected(
        "calibration",
        sbc.tasks_of(kinds, arguments.seed, arguments.runs, arguments.seconds, rows),
        sbc.run,
        sbc.failed,
        workers.asked_for(arguments),
        Sink[SbcRow](path, as_line, append=True),
    )
    rows |= {row.task: row for row in finished}
    if rows:
        _conclude(sbc.in_order(rows.values()), path)
    return status


def _conclude(rows: Sequence[SbcRow], path: Path) -> None:
    rewrite(path, map(as_line, rows))
    print(report(rows))
    print(f"written: {path}")


def _done(path: Path, seconds: float) -> dict[SbcTask, SbcRow]:
    """The runs that a file has; CliError for others, or runs that last otherwise."""
    rows = already_in(path, row_from)
    other = next((row for row in rows if row.seconds != seconds), None)
    if other is not None:
        raise CliError(BAD_INPUT, f"{path}: has runs of {other.seconds:g} s, not {seconds:g} s")
    return {row.task: row for row in rows}
