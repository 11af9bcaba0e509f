"""Unknown objects explored in the emulated rig, faster than real time, beside who knows them and open-loop plans."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from palmd.console.arguments import count, seconds, seed
from palmd.console.configured import configured
from palmd.console.extras import drawing
from palmd.rig.shapes import KINDS
from palmd.rig.simulate import CALIBRATION
from tools.studies import exploring
from tools.studies.bench_montecarlo import ALL
from tools.studies.exploring import ExploringRow
from tools.studies.exploring_summary import remarks, table
from tools.studies.rows import ROWS, Sink, collected, on_this_machine, rewrite
from tools.studies.scoring import as_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=10, metavar="N", help="how many objects of each kind (default: %(default)s)")
    add("--kind", choices=(*KINDS, ALL), default=ALL, help="what sort of object (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first object's (default: %(default)s)")
    add("--seconds", type=seconds, default=60.0, metavar="S", help="how long each may take (default: %(default)s)")
    add("-o", "--output", type=Path, default=Path("explore"), metavar="FOLDER",
        help=f"for {ROWS} and the figure, which are overwritten (default: %(default)s)")  # fmt: skip
    add("--imperfections", choices=CALIBRATION, default="none", help="of the rig, drawn (default: %(default)s)")
    add("--config", type=Path, help="the rig, with its imperfections; default: VersaPads and an arm")
    add("--jobs", type=count, metavar="J", help="processes on this machine (default: one a processor)")


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it ends with what is finished until then; CliError when it cannot begin."""
    kinds = KINDS if arguments.kind == ALL else (arguments.kind,)
    if arguments.config is not None:
        configured(arguments.config)
    tasks = exploring.tasks_of(
        kinds,
        arguments.seed,
        arguments.runs,
        arguments.seconds,
        imperfections=arguments.imperfections,
        config=arguments.config,
    )
    path = arguments.output / ROWS
    finished, status = collected(
        "exploring",
        tasks,
        exploring.run,
        exploring.failed,
        on_this_machine(arguments.jobs),
        Sink[ExploringRow](path, as_line),
    )
    if finished:
        _conclude(exploring.in_order(finished), path)
    return status


def _conclude(rows: Sequence[ExploringRow], path: Path) -> None:
    rewrite(path, map(as_line, rows))
    print(f"seeds {rows[0].seed} to {max(row.seed for row in rows)}")
    print(table(rows))
    for remark in remarks(rows):
        print(remark)
    print(f"written: {', '.join(map(str, [path, *_figure(rows, path.parent)]))}")


def _figure(rows: Sequence[ExploringRow], folder: Path) -> list[Path]:
    figure = drawing("tools.studies.exploring_figure")
    return figure.save(rows, folder) if figure else []
