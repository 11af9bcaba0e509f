"""The runs behind the figures of CMU-CS-01-107 again: its method and palmd's."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from palmd.cli.logs import read
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import missing, only_without
from palmd.console.progress import Progress
from palmd.record.eventlog import EventLog
from palmd.rig.shapes import Kind
from tools.studies.paper_report import as_text, rows
from tools.studies.paper_runs import SideBySide, paper_simulation, side_by_side
from tools.studies.simulated import simulated

DEFAULT_RUNS: tuple[tuple[Kind, int], ...] = (("friction", 401), ("friction", 405), ("rig", 401), ("rig", 404))
SECONDS = 10.0
_TOLD = ("t", "psi_rad", "r1_m", "r2_m", "theta_rad", "h_m")

Told = dict[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    add = parser.add_argument
    add("logs", nargs="*", type=Path, default=[], metavar="LOG",
        help="event logs with their truth in *.truth.json beside them (default: four simulated runs)")  # fmt: skip
    add("-o", "--output", type=Path, default=Path(), metavar="FOLDER", help="for the figures (default: here)")


def run(arguments: argparse.Namespace) -> int:
    """Prints the table, saves the figures; CliError when a log or its truth cannot be used."""
    logs: Sequence[Path] = arguments.logs
    output: Path = arguments.output
    try:
        from tools.studies import paper_figures, stable_pose_figures
    except ModuleNotFoundError as error:
        only_without("matplotlib", error)
        raise missing("the figures", "matplotlib", "studies") from None
    runs = [(path.stem, read(path), _truth(path)) for path in logs] or [
        (f"{kind} {seed}", *simulated(kind, seed, SECONDS)) for kind, seed in DEFAULT_RUNS
    ]
    sides = _compared(runs)
    simulation = paper_simulation()
    print(as_text(rows(simulation, sides)), end="")
    try:
        output.mkdir(parents=True, exist_ok=True)
        saved = paper_figures.save(simulation, sides, output) + stable_pose_figures.save(output)
    except OSError as error:
        raise CliError(BAD_INPUT, f"{output}: cannot be written: {error.strerror or error}") from None
    print("figures: " + ", ".join(map(str, saved)))
    return 0


def _compared(runs: list[tuple[str, EventLog, Told]]) -> list[SideBySide]:
    sides = []
    with Progress("both methods", len(runs), "runs") as progress:
        for name, log, told in runs:
            sides.append(side_by_side(name, log, told))
            progress.at(len(sides))
    return sides


def _truth(log: Path) -> Told:
    path = log.with_suffix(".truth.json")
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: {error.strerror or error}; the report needs each log's truth") from None
    except ValueError as error:
        raise CliError(BAD_INPUT, f"{path}: not JSON: {error}") from None
    missing = [name for name in _TOLD if not (isinstance(told, dict) and isinstance(told.get(name), list))]
    if missing:
        raise CliError(BAD_INPUT, f"{path}: no truth: {', '.join(missing)} missing")
    result: Told = told
    return result
