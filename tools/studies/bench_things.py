"""Dice, nuts, coins and blocks on the emulated rig: how often a live estimate is valid and wrong; prints the seeds.

With --offline: logs of polygons, of dented and of dry lumps, of dice and profiles, reconstructed blind: how many are
right, wrong, refused. With --explored: the same bodies, each explored in the emulated rig, and its recording
reconstructed; with --plan: each moved by a plan in it.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from palmd.config.plans import ExploreGoal
from palmd.config.two_palms import PlanSpec
from palmd.console.arguments import count, seconds, seed
from palmd.console.errors import BAD_INPUT, CliError
from palmd.daemon.planner import read_plan
from palmd.motion.check import motion_limits
from palmd.rig.simulate import CALIBRATION
from palmd.rig.world import default_config
from palmd.yamlfile import ConfigError, load_plan
from tools.studies import thing_logs, things
from tools.studies.bench_montecarlo import ALL
from tools.studies.exploring_plans import plan
from tools.studies.rows import collected, on_this_machine

LIVE_S, LOG_S = 15.0, 20.0  # how long each lasts


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=10, metavar="N", help="how many of each kind (default: %(default)s)")
    kinds = tuple(dict.fromkeys((*things.KINDS, *thing_logs.KINDS, ALL)))
    add("--kind", choices=kinds, default=ALL, help="what lies on the palms (default: %(default)s)")
    offline = parser.add_mutually_exclusive_group().add_argument
    offline(
        "--offline",
        action="store_true",
        help="reconstruct logs of the kinds that are told by their corners or dents, or that stick",
    )
    offline("--explored", action="store_true", help="the same of recordings: each is explored in the emulated rig")
    offline("--plan", type=Path, metavar="FILE", help="the same of recordings of a motion plan in the emulated rig")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds, metavar="S", help="how long each lasts (default: 15; 20 where it is reconstructed)")
    add(
        "--imperfections",
        choices=tuple(CALIBRATION),
        default="none",
        help="what the rig is off by, drawn by the seed (default: %(default)s)",
    )
    add("--jobs", type=count, metavar="J", help="processes on this machine (default: one a processor)")


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it tells of what is finished until then. CliError for a kind that there are no such runs of."""
    recorded = arguments.explored or arguments.plan is not None
    offline = bool(arguments.offline) or recorded
    study: Any = thing_logs if offline else things  # two modules with the same functions, each of its own rows
    known: tuple[str, ...] = study.KINDS
    if arguments.kind not in (*known, ALL):
        wanted = "without --offline, --explored and --plan" if offline else "with --offline, --explored or --plan"
        raise CliError(BAD_INPUT, f"--kind {arguments.kind} is {wanted}; here there are: {', '.join(known)}")
    kinds = known if arguments.kind == ALL else (arguments.kind,)
    length = arguments.seconds or (LOG_S if offline else LIVE_S)
    moves = _moves(arguments.plan, length) if recorded else None
    print(f"seeds {arguments.seed} to {arguments.seed + arguments.runs - 1}")
    tasks = study.tasks_of(kinds, arguments.seed, arguments.runs, length, arguments.imperfections)
    if moves is not None:
        tasks = [replace(task, plan=moves) for task in tasks]
    what, workers = "logs" if offline else "things", on_this_machine(arguments.jobs)
    finished, status = collected(what, tasks, study.run, study.failed, workers)
    rows = sorted(finished, key=lambda row: (known.index(row.kind), row.seed))
    if rows:
        print(study.table(rows))
    for remark in study.remarks(rows):
        print(remark)
    return status


def _moves(path: Path | None, seconds: float) -> PlanSpec:
    """The plan in a file, None: an exploration that takes so long. CliError with all that is wrong with it."""
    config = default_config()
    if path is None:
        return plan("explore", config, ExploreGoal(coverage=1.0, time_limit_s=seconds), seed=0)
    try:
        read_plan(path, motion_limits(config), None)
        return load_plan(path)
    except ConfigError as error:
        raise CliError(BAD_INPUT, str(error)) from None
