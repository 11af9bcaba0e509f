"""Random objects in random motion, reconstructed blind, scored against their truth and the Cramér–Rao bound."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path

from palmd.console.arguments import count, seconds, seed
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import drawing, missing, only_without
from palmd.lab import montecarlo, runs
from palmd.lab.montecarlo_summary import remarks, summaries, table
from palmd.lab.rows import ROWS, Sink, collected, on_this_machine, rewrite
from palmd.lab.scoring import MonteCarloRow, as_line
from palmd.rig.shapes import KINDS
from palmd.rig.simulate import CALIBRATION

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
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=count, metavar="J", help="processes on this machine (default: one a processor)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster, such as tcp://127.0.0.1:8786")


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
        lambda stack: _workers(stack, arguments),
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
    figure = drawing("palmd.lab.montecarlo_figure")
    return figure.save(rows, folder) if figure else []


def _workers(stack: ExitStack, arguments: argparse.Namespace) -> Executor:
    address = arguments.scheduler
    if address is None:
        return on_this_machine(arguments.jobs)(stack)
    try:
        return stack.enter_context(runs.cluster(address))
    except ModuleNotFoundError as error:
        only_without("distributed", error)
        raise missing("--scheduler", "Dask", "lab") from None
    except (OSError, ValueError) as error:
        raise CliError(BAD_INPUT, f"no Dask scheduler at {address}: {error}") from None
