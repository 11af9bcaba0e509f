"""Test objects such as dice, nuts, coins and blocks on the emulated rig: how often a live estimate is valid and wrong.

The daemon's core and its smoother run in a simulated closed loop on random moves, blind; each run is defined by kind
and seed. Corners, dents and dry lumps are logs of `object_logs`, replayed through the live observer. With --offline:
logs of polygons, dented lumps, dry lumps, dice and profiles, reconstructed blind: how many are right, wrong, rejected.
With --explored: the same bodies, each explored in the emulated rig, and the recording reconstructed. With --plan: each
moved by a plan instead.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palmd.config.plans import ExploreGoal
from palmd.config.two_palms import DrawnImperfections, rig_description
from palmd.console.errors import BAD_INPUT, CliError
from palmd.observer import Simulated
from palmd.quantities import ESTIMATE, UNEXPLAINED
from palmd.rig.shapes import Body, random_body
from palmd.rig.world import default_config
from palmd.system.mechanism import RADII
from tools.closed_loop import TwoPalmsLoop
from tools.studies import harness, object_logs
from tools.studies.cells import Cell, mean, most, runs, total
from tools.studies.exploration_plans import plan
from tools.studies.harness import Study, result
from tools.studies.object_logs import SharpTask
from tools.studies.real_objects import REAL_OBJECTS, real_object
from tools.studies.scoring import FAR, ObserverAnswers, replayed

LUMP = "lump"  # a smooth body as in other studies
LOGGED: tuple[str, ...] = tuple(kind for kind in object_logs.KINDS if kind not in REAL_OBJECTS)
KINDS: tuple[str, ...] = (*REAL_OBJECTS, LUMP, *LOGGED)
OFF_CENTRE_EVERY, OFF_CENTRE_M = 3, 1e-3  # every third body has an eccentric centre of mass, by 1 mm
MUCH = 0.01  # share of wrong ticks from which a run gets a remark
LIVE_S = 15.0  # duration of a run
_STREAM = 18  # random stream of the bodies, distinct from the motion's
_RADII = tuple(f"{name}_m" for name in RADII)
_MARGIN_S = 2.0  # by which the moves last longer than the run


@dataclass(frozen=True, slots=True)
class ObjectTask:
    """One run: kind of object, seed, duration (s). Every third seed's centre of mass is eccentric."""

    kind: str
    seed: int
    seconds: float = 15.0
    imperfections: DrawnImperfections = "none"


@dataclass(frozen=True, slots=True)
class ObjectRow(ObjectTask):
    """The results of one run; NaN for missing values.

    valid, wrong, far: shares of all ticks from the first move on; wrong: valid with an error of a radius above 0.3 mm;
    far: above 3σ. most_m: the largest such error. refusals: rejections by the smoother. losses: lost contacts. For a
    log only shares and error.
    """

    error: str = ""
    valid: float = math.nan
    wrong: float = math.nan
    most_m: float = math.nan
    refusals: int = 0
    losses: int = 0
    far: float = math.nan


def body_of(task: ObjectTask) -> Body:
    """The task's body."""
    random = np.random.default_rng([_STREAM, KINDS.index(task.kind), task.seed])
    if task.kind == LUMP:
        return random_body("rig", random)
    eccentricity = OFF_CENTRE_M if task.seed % OFF_CENTRE_EVERY == OFF_CENTRE_EVERY - 1 else 0.0
    return real_object(task.kind, random, eccentricity).body


def run(task: ObjectTask) -> ObjectRow:
    """Run the closed loop, or replay a log, and score it."""
    if task.kind in LOGGED:
        log, truth, _ = object_logs.simulated(SharpTask(task.kind, task.seed, task.seconds, task.imperfections))
        live, counts = replayed(log, truth), dict[str, int]()
    else:
        live, counts = _moved(task)
    misses = np.abs(live.r_error)
    return result(
        ObjectRow,
        task,
        valid=float(live.valid.mean()),
        wrong=float(live.wrong.mean()),
        most_m=float(misses[live.valid].max()) if live.valid.any() else math.nan,
        far=float((live.valid & (misses > FAR * live.r_sd).any(axis=1)).mean()),
        **counts,
    )


def _moved(task: ObjectTask) -> tuple[ObserverAnswers, dict[str, int]]:
    """Estimates in the closed loop on random moves, and counts of the row."""
    config = default_config(task.imperfections)
    moves = plan("random", config, ExploreGoal(time_limit_s=task.seconds + _MARGIN_S), task.seed)
    smoothing = Simulated(rig_description(config))
    loop = TwoPalmsLoop(config, moves, task.seed, smoothing=smoothing, body=body_of(task))
    loop.start()
    t_start, before, rejections = loop.t, loop.world.status()["contact_losses"], 0
    rows = list[tuple[float, ...]]()
    for instant in loop.run(task.seconds):
        rejections += UNEXPLAINED.name in instant.messages
        estimate, truth = instant.messages[ESTIMATE.name], instant.truth
        errors = (estimate[name] - truth[name] for name in _RADII)
        rows.append((instant.t - t_start, estimate["valid"], *errors, *(estimate["sd"][name] for name in _RADII)))
    t, valid, *each = np.array(rows, dtype=np.float64).T
    answers = ObserverAnswers(t, valid > 0.0, np.column_stack(each[:2]), np.column_stack(each[2:]))
    losses = int(loop.world.status()["contact_losses"] - before)
    return answers, {"refusals": rejections, "losses": losses}


def totals(rows: Sequence[ObjectRow]) -> list[str]:
    """The columns for all objects together, without the smooth lump."""
    some = [row for row in rows if row.kind != LUMP and not row.error]
    return [f"all objects: {', '.join(f'{title} {cell(some)}' for title, cell in COLUMNS)}"] if some else []


COLUMNS: list[tuple[str, Cell]] = [
    ("runs", runs),
    ("valid", mean(lambda row: row.valid, ".0%")),
    ("wrong, of all ticks", mean(lambda row: row.wrong, ".1%")),
    ("worst run, %", most(lambda row: row.wrong, 100.0)),
    ("beyond 3 sd", mean(lambda row: row.far, ".1%")),
    ("largest error (mm)", most(lambda row: row.most_m, 1e3)),
    ("rejections", total(lambda row: row.refusals)),
    ("contacts lost", total(lambda row: row.losses)),
]

OFFLINE = object_logs.OFFLINE
LIVE = Study(
    "test objects",
    harness.of_kinds(KINDS, lambda kind, seed, of: ObjectTask(kind, seed, of.seconds or LIVE_S, of.imperfections)),
    run,
    ObjectRow,
    order=lambda row: (KINDS.index(row.kind), row.seed),
    by=lambda row: row.kind,
    columns=COLUMNS,
    totals=totals,
    remark=lambda row: f"wrong for {row.wrong:.1%}, by up to {1e3 * row.most_m:.2f} mm" if row.wrong > MUCH else "",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    kinds = tuple(dict.fromkeys((*KINDS, *object_logs.KINDS)))
    harness.add_arguments(parser, runs=10, seconds_each=None, output=None, kinds=kinds)
    add = parser.add_mutually_exclusive_group().add_argument
    add("--offline", action="store_true", help="reconstruct logs of corners, dents and dry lumps")
    add("--explored", action="store_true", help="reconstruct recordings of explorations in the emulated rig")
    add("--plan", type=Path, metavar="FILE", help="reconstruct recordings of a motion plan in the emulated rig")
    harness.add_imperfections(parser)


def conduct(arguments: argparse.Namespace) -> int:
    """Run the live or the offline study; raises CliError for a kind that the study does not have."""
    offline = arguments.offline or arguments.explored or arguments.plan is not None
    known: tuple[str, ...] = object_logs.KINDS if offline else KINDS
    if arguments.kind not in (*known, harness.ALL):
        option = "without --offline, --explored and --plan" if offline else "with --offline, --explored or --plan"
        raise CliError(BAD_INPUT, f"--kind {arguments.kind} is only possible {option}; here use {', '.join(known)}")
    return OFFLINE.conduct(arguments) if offline else LIVE.conduct(arguments)
