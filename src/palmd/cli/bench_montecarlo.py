"""Random objects in random motion, reconstructed blind, scored against their truth and the Cramér–Rao bound."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

from palmd.cli import INTERRUPTED
from palmd.cli.errors import BAD_INPUT, CliError
from palmd.cli.extras import only_without
from palmd.cli.progress import Progress
from palmd.cli.rows import ROWS, rewrite, terminable, writable, write
from palmd.rig.shapes import KINDS
from palmd.study import montecarlo, runs
from palmd.study.montecarlo import Task
from palmd.study.montecarlo_summary import remarks, summaries, table
from palmd.study.scoring import Row, as_line

ALL = "all"
_SHORTEST_S = 0.5


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
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=count, metavar="J", help="processes on this machine (default: one a processor)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster, such as tcp://127.0.0.1:8786")


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it ends with what is finished until then; CliError when it cannot begin."""
    kinds = KINDS if arguments.kind == ALL else (arguments.kind,)
    tasks = montecarlo.tasks_of(kinds, arguments.seed, arguments.runs, arguments.seconds, arguments.causal)
    finished: list[Row] = []
    status = 0
    path = arguments.output / ROWS
    try:
        with terminable(), ExitStack() as stack:
            executor = _workers(stack, arguments)  # first: rows of an earlier study outlive a wrong address
            _collect(executor, tasks, writable(stack, path), finished)
    except KeyboardInterrupt:
        print(f"interrupted: {len(finished)} of {len(tasks)} runs are finished", file=sys.stderr)
        status = INTERRUPTED
    if finished:
        _conclude(montecarlo.in_order(finished), path)
    return status


def _collect(executor: Executor, tasks: Sequence[Task], stream: TextIO, finished: list[Row]) -> None:
    """Each row is in the file as soon as it is finished: a study takes hours."""
    with Progress("Monte Carlo", len(tasks), "runs") as progress:
        for row in runs.finished(executor, montecarlo.run, montecarlo.failed, tasks):
            write(stream, [as_line(row)])
            finished.append(row)
            progress.at(len(finished))


def _conclude(rows: Sequence[Row], path: Path) -> None:
    rewrite(path, map(as_line, rows))
    print(table(summaries(rows)))
    for remark in remarks(rows):
        print(remark)
    print(f"written: {', '.join(map(str, [path, *_figure(rows, path.parent)]))}")


def _figure(rows: Sequence[Row], folder: Path) -> list[Path]:
    try:
        from palmd.study import montecarlo_figure
    except ModuleNotFoundError as error:
        only_without("matplotlib", error)
        print("no figure: matplotlib is not installed (extra `report`)", file=sys.stderr)
        return []
    return montecarlo_figure.save(rows, folder)


def _workers(stack: ExitStack, arguments: argparse.Namespace) -> Executor:
    address = arguments.scheduler
    if address is None:
        return stack.enter_context(runs.local(arguments.jobs or os.cpu_count() or 1))
    try:
        return stack.enter_context(runs.cluster(address))
    except ModuleNotFoundError as error:
        only_without("distributed", error)
        raise CliError(BAD_INPUT, "--scheduler needs Dask, which is not installed (extra `cluster`)") from None
    except (OSError, ValueError) as error:
        raise CliError(BAD_INPUT, f"no Dask scheduler at {address}: {error}") from None


def count(text: str) -> int:
    """A whole number from 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is less than 1")
    return value


def seed(text: str) -> int:
    """A whole number from 0."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value} is negative")
    return value


def seconds(text: str) -> float:
    """A duration that leaves something to see (s)."""
    value = float(text)
    if not _SHORTEST_S <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{value:g} s is no duration from {_SHORTEST_S:g} s")
    return value
