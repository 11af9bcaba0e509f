"""The runs behind the figures of CMU-CS-01-107 again: its method and palmd's."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from palmd.cli.errors import BAD_INPUT, CliError
from palmd.cli.extras import only_without
from palmd.cli.logs import read
from palmd.cli.progress import Progress
from palmd.record.eventlog import EventLog
from palmd.rig.shapes import Kind
from palmd.study.paper_report import as_text, rows
from palmd.study.paper_runs import SideBySide, paper_simulation, side_by_side
from palmd.study.simulated import simulated

DEFAULT_RUNS: tuple[tuple[Kind, int], ...] = (("friction", 401), ("friction", 405), ("rig", 401), ("rig", 404))
SECONDS = 10.0
LOGS = (
    "event logs with their truth beside them (LOG without .jsonl, plus .truth.json); "
    f"default: simulated runs {', '.join(f'{kind} {seed}' for kind, seed in DEFAULT_RUNS)}"
)
"""What the command takes, in words."""

_TOLD = ("t", "psi_rad", "r1_m", "r2_m", "theta_rad", "h_m")

Told = dict[str, Any]


def run(logs: Sequence[Path], output: Path) -> int:
    """Prints the table, saves the figures; CliError when a log or its truth cannot be used."""
    try:
        from palmd.study import paper_figures, stable_pose_figures
    except ModuleNotFoundError as error:
        only_without("matplotlib", error)
        raise CliError(BAD_INPUT, "the figures need matplotlib, which is not installed (extra `report`)") from None
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
