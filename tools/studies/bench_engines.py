"""Comparison with physics engines: bodies on vibrating palms in MuJoCo, Drake and Chipmunk, estimated blind.

Each run draws a body, a motion, friction and a vibration, simulates it in an engine with the engine's friction model,
writes an event log, and compares `reconstruct` and the live observer with the engine's truth. With --daemon the whole
daemon explores instead, with MuJoCo and with palmd's own plant in the emulated rig. A file with runs is resumed: the
same command does the missing runs and reports all.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from palmd.console.extras import require
from palmd.rig.simulate import CALIBRATION
from tools.studies import harness
from tools.studies.engines import daemon, study
from tools.studies.engines.scene import ENGINE_KINDS
from tools.studies.engines.study import ENGINES, EngineName, EngineRow, EngineTask
from tools.studies.harness import ALL, Study

_PACKAGES: dict[EngineName, str] = {"mujoco": "mujoco", "drake": "pydrake", "chipmunk": "pymunk"}


def conduct(arguments: argparse.Namespace) -> int:
    """Run the study of engine logs, or with --daemon the closed loop."""
    if not arguments.daemon:
        return LOGS.conduct(arguments)
    require("--daemon", "mujoco", "mujoco")
    return daemon.STUDY.conduct(arguments)


def draw(arguments: argparse.Namespace) -> Sequence[EngineTask]:
    """The requested number of runs of each combination; raises CliError if an engine is not installed."""
    engines = ENGINES if arguments.engine == ALL else (arguments.engine,)
    for engine in engines:
        require(f"--engine {engine}", _PACKAGES[engine], "engines")
    known = tuple(CALIBRATION) if arguments.imperfections == ALL else (arguments.imperfections,)
    kinds = harness.kinds_of(arguments, ENGINE_KINDS)
    return study.tasks_of(engines, kinds, known, arguments.seed, arguments.runs, arguments.seconds)


LOGS = Study(
    "engines",
    draw,
    study.run,
    EngineRow,
    order=lambda row: (ENGINES.index(row.engine), ENGINE_KINDS.index(row.kind), row.known, row.seed),
    report=study.table,
    resumes=True,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(
        parser, runs=2, seconds_each=10.0, output="engines.jsonl", kinds=ENGINE_KINDS, what="of each combination"
    )
    add = parser.add_argument
    add("--engine", choices=(*ENGINES, ALL), default=ALL, help="physics engine (default: %(default)s)")
    add("--daemon", action="store_true", help="the whole daemon explores ellipses, in MuJoCo and in palmd's own plant")
    add("--imperfections", choices=(*CALIBRATION, ALL), default=ALL, help="of the rig, drawn (default: %(default)s)")
