"""One thing is not as described: what is still claimed, how far off it is, and whether the cause is named.

Runs of 20 s (kinds friction and rig in turns) on an emulated rig of which one constant is off, or whose readings are
spoilt; the rest is exactly as described and declared so (`exact`), or as calibration leaves a rig (`calibrated`).
Or the object is explored in closed loop, the rest of the rig exactly as described: when the outline would be led
astray, and when what is off has its name.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.console.arguments import count, seconds, seed
from tools.studies import off, off_explored, workers
from tools.studies.off import OFF, TAKEN_FOR, OffRow, report
from tools.studies.off_explored import CAN_BE_OFF, ExploredRow
from tools.studies.rows import Sink, collected, rewrite
from tools.studies.scoring import as_line

_ORDER = [each.name for each in OFF]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=4, metavar="N", help="how many of each (default: %(default)s)")
    add("--taken-for", choices=TAKEN_FOR, nargs="+", default=TAKEN_FOR, metavar="WORLD",
        help=f"what the rest of the rig is: {', '.join(TAKEN_FOR)} (default: both)")  # fmt: skip
    add("--only", choices=_ORDER, nargs="+", default=_ORDER, metavar="WHAT",
        help=f"what is off: {'; '.join(_ORDER)} (default: each of them)".replace("%", "%%"))  # fmt: skip
    add_way = parser.add_mutually_exclusive_group().add_argument
    add_way("--explored", action="store_true", help="explore, on a rig declared exact of which a constant is off")
    add_way("--live", action="store_true",
        help="replay each log through the live observer too, as `palmd estimate` does")  # fmt: skip
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds, default=20.0, metavar="S", help="how long each lasts (default: %(default)g)")
    add("-o", "--output", type=Path, default=Path("off.jsonl"), metavar="FILE",
        help="a JSON line for each run, overwritten (default: %(default)s)")  # fmt: skip
    workers.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it ends with what is finished until then; CliError when it cannot begin."""
    return _explored(arguments) if arguments.explored else _reconstructed(arguments)


def _explored(arguments: argparse.Namespace) -> int:
    offs = [name for name in arguments.only if name in CAN_BE_OFF]
    tasks = off_explored.tasks_of(offs, arguments.seed, arguments.runs, arguments.seconds)
    sink = Sink[ExploredRow](arguments.output, as_line)
    asked = workers.asked_for(arguments)
    rows, status = collected("one thing off, explored", tasks, off_explored.run, off_explored.failed, asked, sink)
    if rows:
        rows.sort(key=lambda row: (_ORDER.index(row.off), row.seed))
        print(off_explored.report(rows))
        print(f"written: {arguments.output}")
    return status


def _reconstructed(arguments: argparse.Namespace) -> int:
    tasks = off.tasks_of(
        arguments.only, arguments.taken_for, arguments.seed, arguments.runs, arguments.seconds, arguments.live
    )
    sink = Sink[OffRow](arguments.output, as_line)
    rows, status = collected("one thing off", tasks, off.run, off.failed, workers.asked_for(arguments), sink)
    if rows:
        rows.sort(key=lambda row: (TAKEN_FOR.index(row.taken_for), _ORDER.index(row.off), row.seed))
        rewrite(arguments.output, map(as_line, rows))
        print(f"seeds {arguments.seed}–{arguments.seed + arguments.runs - 1}, {arguments.seconds:g} s each")
        print(report(rows))
        print(f"written: {arguments.output}")
    return status
