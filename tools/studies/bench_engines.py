"""Physics engines as judges: bodies on vibrating palms in MuJoCo, Drake and Chipmunk, estimated blind.

Each run draws a body, a motion, friction and a vibration, simulates it in an engine with its own friction, writes an
event log, and compares `reconstruct` and the live observer with the engine's truth. A file that has runs already is
resumed: the same command does those that are not there yet, and reports all.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.console.arguments import count, seconds, seed
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import missing
from palmd.rig.simulate import CALIBRATION
from tools.studies import workers
from tools.studies.bench_montecarlo import ALL
from tools.studies.engines import study
from tools.studies.engines.scene import ENGINE_KINDS
from tools.studies.engines.study import ENGINES, EngineRow
from tools.studies.rows import Sink, already_in, collected, rewrite


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=2, metavar="N", help="how many of each combination (default: %(default)s)")
    add("--engine", choices=(*ENGINES, ALL), default=ALL, help="whose physics (default: %(default)s)")
    add("--kind", choices=(*ENGINE_KINDS, ALL), default=ALL, help="friction and vibration (default: %(default)s)")
    add("--imperfections", choices=(*CALIBRATION, ALL), default=ALL, help="of the rig, drawn (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds, default=10.0, metavar="S", help="how long each lasts (default: %(default)s)")
    add("-o", "--output", type=Path, default=Path("engines.jsonl"), metavar="FILE",
        help="a JSON line for each run, to resume (default: %(default)s)")  # fmt: skip
    workers.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it ends with what is finished until then; CliError where an engine or the file cannot be used."""
    engines = ENGINES if arguments.engine == ALL else (arguments.engine,)
    for engine in engines:
        try:
            study.engine_called(engine)
        except ModuleNotFoundError:
            package = {"chipmunk": "pymunk"}.get(engine, engine)
            raise missing(f"--engine {engine}", package, "engines") from None
    kinds = ENGINE_KINDS if arguments.kind == ALL else (arguments.kind,)
    known = tuple(CALIBRATION) if arguments.imperfections == ALL else (arguments.imperfections,)
    path: Path = arguments.output
    try:
        rows = {row.task: row for row in already_in(path, study.row_from)}
    except (TypeError, KeyError) as error:
        raise CliError(BAD_INPUT, f"{path}: has rows of another study: {error}") from None
    finished, status = collected(
        "engines",
        study.tasks_of(engines, kinds, known, arguments.seed, arguments.runs, arguments.seconds, rows),
        study.run,
        study.failed,
        workers.asked_for(arguments),
        Sink[EngineRow](path, study.as_line, append=True),
    )
    rows |= {row.task: row for row in finished}
    if rows:
        ordered = study.in_order(rows.values())
        rewrite(path, map(study.as_line, ordered))
        print(study.table(ordered))
        print(f"written: {path}")
    return status
