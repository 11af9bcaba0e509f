"""Dice, nuts, coins and blocks on the emulated rig: how often a live estimate is valid and wrong.

The daemon's core and its smoother against the plant, without wires, on moves drawn at random; blind, each run by its
kind and seed. Corners, dents and dry lumps of `thing_logs` are these logs, replayed through the live observer. With
--offline: logs of polygons, of dented and of dry lumps, of dice and profiles, reconstructed blind: how many are right,
wrong, rejected. With --explored: the same bodies, each explored in the emulated rig, and its recording reconstructed;
with --plan: each moved by a plan in it.
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
from palmd.harness.scorer import Scorer
from palmd.observer import Simulated, make
from palmd.quantities import ESTIMATE, UNEXPLAINED
from palmd.rig.shapes import Body, random_body
from palmd.rig.simulate import CALIBRATION
from palmd.rig.world import default_config
from palmd.score import WRONG_M
from palmd.system.mechanism import RADII
from tools.studies import harness, thing_logs
from tools.studies.cells import Cell, mean, most, runs, total
from tools.studies.exploring_plans import plan
from tools.studies.harness import Study, kinds_of, result, seeds_of
from tools.studies.montecarlo import answers
from tools.studies.real_things import THINGS, thing
from tools.studies.scoring import FAR
from tools.wireless import Wireless

LUMP = "lump"  # a smooth one, as other studies have
LOGGED: tuple[str, ...] = tuple(kind for kind in thing_logs.KINDS if kind not in THINGS)
KINDS: tuple[str, ...] = (*THINGS, LUMP, *LOGGED)
OFF_CENTRE_EVERY, OFF_CENTRE_M = 3, 1e-3
MUCH = 0.01  # of the ticks
LIVE_S = 15.0  # how long each lasts
_STREAM = 18  # keeps the bodies' random numbers apart from those of the motion
_MARGIN_S = 2.0  # by which the moves last longer than the run


@dataclass(frozen=True, slots=True)
class ThingTask:
    """One run to do: what lies on the palms, the seed, and how long (s). Every third seed's mass is off-centre."""

    kind: str
    seed: int
    seconds: float = 15.0
    imperfections: DrawnImperfections = "none"


@dataclass(frozen=True, slots=True)
class ThingRow(ThingTask):
    """A run in numbers; NaN for what there is not.

    valid, wrong, far: shares of all ticks from the first move on; wrong: valid, and a radius off by more than 0.3 mm;
    far: by more than three of its one-sigmas. most: the largest such error (m). refusals: of the smoother. losses:
    of a contact. Of a log the shares and the error alone.
    """

    error: str = ""
    valid: float = math.nan
    wrong: float = math.nan
    most_m: float = math.nan
    refusals: int = 0
    losses: int = 0
    far: float = math.nan


def body_of(task: ThingTask) -> Body:
    """What lies on the palms."""
    random = np.random.default_rng([_STREAM, KINDS.index(task.kind), task.seed])
    if task.kind == LUMP:
        return random_body("rig", random)
    off = OFF_CENTRE_M if task.seed % OFF_CENTRE_EVERY == OFF_CENTRE_EVERY - 1 else 0.0
    return thing(task.kind, random, off).body


def run(task: ThingTask) -> ThingRow:
    """Move, estimate and compare."""
    if task.kind in LOGGED:
        return _replayed(task)
    config = default_config(task.imperfections)
    moves = plan("random", config, ExploreGoal(time_limit_s=task.seconds + _MARGIN_S), task.seed)
    smoothing = Simulated(rig_description(config))
    wireless = Wireless(config, moves, task.seed, smoothing=smoothing, body=body_of(task))
    wireless.start()
    scorer, ticks, valid, wrong, far, most, refusals = Scorer(wireless.t), 0, 0, 0, 0, 0.0, 0
    before = wireless.world.status()["contact_losses"]
    for instant in wireless.run(task.seconds):
        estimate = instant.messages[ESTIMATE.name]
        ticks += 1
        refusals += UNEXPLAINED.name in instant.messages
        if scorer.take(instant.t, estimate):
            misses = {name: abs(estimate[name] - instant.truth[name]) for name in (f"{radius}_m" for radius in RADII)}
            error = max(misses.values())
            valid += 1
            far += any(miss > FAR * estimate["sd"][name] for name, miss in misses.items())
            wrong += error > WRONG_M
            most = max(most, error)
    status = wireless.world.status()
    return result(
        ThingRow,
        task,
        valid=valid / ticks,
        wrong=wrong / ticks,
        most_m=most if valid else math.nan,
        refusals=refusals,
        losses=int(status["contact_losses"] - before),
        far=far / ticks,
    )


def _replayed(task: ThingTask) -> ThingRow:
    logged = thing_logs.SharpTask(task.kind, task.seed, task.seconds, task.imperfections)
    log, truth, _ = thing_logs.simulated(logged)
    live = answers(log, truth, make("shape", log.rig, smoothing=Simulated(log.rig)))
    misses = np.abs(live.r_error)
    error = misses.max(axis=1)
    return result(
        ThingRow,
        task,
        valid=float(live.valid.mean()),
        wrong=float(live.wrong.mean()),
        most_m=float(error[live.valid].max()) if live.valid.any() else math.nan,
        far=float((live.valid & (misses > FAR * live.r_sd).any(axis=1)).mean()),
    )


def draw(arguments: argparse.Namespace) -> Sequence[ThingTask]:
    """So many of each kind, all with the same seeds."""
    rest = arguments.seconds or LIVE_S, arguments.imperfections
    return [ThingTask(kind, seed, *rest) for seed in seeds_of(arguments) for kind in kinds_of(arguments, KINDS)]


def remarks(rows: Sequence[ThingRow]) -> list[str]:
    """What all but the smooth lump come to, then a line for each run that came to nothing, or was often wrong."""
    some = [row for row in rows if row.kind != LUMP and not row.error]
    said = [f"all things: {', '.join(f'{title} {cell(some)}' for title, cell in COLUMNS)}"] if some else []
    for row in rows:
        if row.error:
            said.append(f"{row.kind} {row.seed}: {row.error}")
        elif row.wrong > MUCH:
            said.append(f"{row.kind} {row.seed}: wrong for {row.wrong:.1%}, by up to {1e3 * row.most_m:.2f} mm")
    return said


COLUMNS: list[tuple[str, Cell]] = [
    ("runs", runs),
    ("valid", mean(lambda row: row.valid, ".0%")),
    ("wrong, of all ticks", mean(lambda row: row.wrong, ".1%")),
    ("worst run, %", most(lambda row: row.wrong, 100.0)),
    ("beyond 3 sd", mean(lambda row: row.far, ".1%")),
    ("largest error (mm)", most(lambda row: row.most_m, 1e3)),
    ("refusals", total(lambda row: row.refusals)),
    ("contacts lost", total(lambda row: row.losses)),
]

LIVE = Study(
    "things",
    draw,
    run,
    ThingRow,
    order=lambda row: (KINDS.index(row.kind), row.seed),
    by=lambda row: row.kind,
    columns=COLUMNS,
    remarks=remarks,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    kinds = tuple(dict.fromkeys((*KINDS, *thing_logs.KINDS)))
    harness.add_arguments(parser, runs=10, seconds_each=None, output=None, kinds=kinds)
    add = parser.add_mutually_exclusive_group().add_argument
    add("--offline", action="store_true", help="reconstruct logs of corners, dents and dry lumps")
    add("--explored", action="store_true", help="the same of recordings: each is explored in the emulated rig")
    add("--plan", type=Path, metavar="FILE", help="the same of recordings of a motion plan in the emulated rig")
    parser.add_argument("--imperfections", choices=tuple(CALIBRATION), default="none",
        help="what the rig is off by, drawn by the seed (default: %(default)s)")  # fmt: skip


def conduct(arguments: argparse.Namespace) -> int:
    """Interrupted, it reports what is finished until then. CliError for a kind that there are no such runs of."""
    offline = arguments.offline or arguments.explored or arguments.plan is not None
    known: tuple[str, ...] = thing_logs.KINDS if offline else KINDS
    if arguments.kind not in (*known, harness.ALL):
        wanted = "without --offline, --explored and --plan" if offline else "with --offline, --explored or --plan"
        raise CliError(BAD_INPUT, f"--kind {arguments.kind} is {wanted}; here there are: {', '.join(known)}")
    return thing_logs.OFFLINE.conduct(arguments) if offline else LIVE.conduct(arguments)
