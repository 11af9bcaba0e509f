"""Random objects in random motion, reconstructed blind, scored against their truth and the Cramér–Rao bound."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from palmd.console.arguments import count, seconds, seed
from palmd.console.extras import drawing
from palmd.rig.shapes import KINDS
from palmd.rig.simulate import CALIBRATION
from tools.studies import montecarlo, workers
from tools.studies.montecarlo_summary import remarks, summaries, table
from tools.studies.rows import ROWS, Sink, collected, rewrite
from tools.studies.scoring import MonteCarloRow, as_line

ALL = "all"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=100, metavar="N", help="how many of each kind (default: %(default)s)")
    add("--kind", choices=(*KINDS, ALL), default=ALL, help="what sort of run (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds, default=10.0, metavar="S", help="how long each lasts (default: %(default)s)")
    add("-o", "--output", type=Path, default=Path("montecarlo"), metavar="FOLDER",
        help=f"for {ROWS} and the figure, which are overwritten (default: %(default)s)")  # fmt: skip
    add("--causal", action=argparse.BooleanOptionalAction, default=True, help="also through the daemon's observer")
    add("--imperfections", choices=CALIBRATION, default="none", help="of the rig, drawn (default: %(default)s)")
    workers.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it ends with what is finished until then; CliError when it cannot begin."""
    kinds = KINDS if arguments.kind == ALL else (arguments.kind,)
    tasks = montecarlo.tasks_of(
        kinds, arguments.seed, arguments.runs, arguments.seconds, arguments.causal, arguments.imperfections
    )
    path = arguments.output / ROWS
    finished, status = collected(
        "Monte Carlo",
        tasks,
        montecarlo.run,
        montecarlo.failed,
        workers.asked_for(arguments),
        Sink[MonteCarloRow](path, as_line),
    )
    if finished:
        _conclude(montecarlo.in_order(finished), path)
    return status


def _conclude(rows: Sequence[MonteCarloRow], path: Path) -> None:
    rewrite(path, map(as_line, rows))
    print(table(summaries(rows)))
    for remark in remarks(rows):
        print(remark)
    print(f"written: {', '.join(map(str, [path, *_figure(rows, path.parent)]))}")


def _figure(rows: Sequence[MonteCarloRow], folder: Path) -> list[Path]:
    figure = drawing("tools.studies.montecarlo_figure")
    return figure.save(rows, folder) if figure else []
