"""Things with corners, flat sides and round ones on the emulated rig: how often the live estimate is valid and wrong.

The daemon's core and its smoother against the plant, without wires, on moves drawn at random; blind, each run by its
kind and seed. Corners, dents and dry lumps that a study of `reconstruct` has logs of (`thing_logs`) are these logs,
replayed through the live observer. `run` gives the same row in any process and in any order.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from palmd.config.plans import ExploreGoal
from palmd.config.two_palms import Drawn, rig_description
from palmd.console.columns import aligned
from palmd.harness.scorer import Scorer
from palmd.harness.wireless import Wireless
from palmd.observer import Simulated, make
from palmd.quantities import ESTIMATE, SHAPE, UNEXPLAINED
from palmd.rig.real_things import THINGS, thing
from palmd.rig.shapes import Body, random_body
from palmd.rig.world import default_config
from palmd.score import WRONG_M
from palmd.system.mechanism import RADII
from tools.studies import thing_logs
from tools.studies.exploring_plans import plan
from tools.studies.montecarlo import answers
from tools.studies.runs import with_failures
from tools.studies.scoring import FAR

LUMP = "lump"  # a smooth one, as other studies have
LOGGED: tuple[str, ...] = tuple(kind for kind in thing_logs.KINDS if kind not in THINGS)
KINDS: tuple[str, ...] = (*THINGS, LUMP, *LOGGED)
OFF_CENTRE_EVERY, OFF_CENTRE_M = 3, 1e-3
MUCH = 0.01  # of the ticks
HEAD = (
    "runs",
    "valid",
    "wrong, of all ticks",
    "worst run",
    "beyond 3 sd",
    "largest error (mm)",
    "refusals",
    "contacts lost",
)
_STREAM = 18  # keeps the bodies' random numbers apart from those of the motion
_MARGIN_S = 2.0  # by which the moves last longer than the run


@dataclass(frozen=True, slots=True)
class ThingTask:
    """One run to do: what lies on the palms, the seed, and how long (s). Every third seed's mass is off-centre."""

    kind: str
    seed: int
    seconds: float = 15.0
    imperfections: Drawn = "none"


@dataclass(frozen=True, slots=True)
class ThingRow:
    """A run in numbers; NaN for what there is not.

    valid, wrong, far: shares of all ticks from the first move on; wrong: valid, and a radius off by more than 0.3 mm;
    far: by more than three of its one-sigmas. most: the largest such error (m). e_h: of the last valid outline where it
    was touched (m). refusals: of the smoother.
    losses: of a contact, falls: off the palms, objects: how many were begun. Of a log the shares and the error alone.
    """

    kind: str
    seed: int
    error: str = ""
    valid: float = math.nan
    wrong: float = math.nan
    most_m: float = math.nan
    e_h_m: float = math.nan
    refusals: int = 0
    losses: int = 0
    falls: int = 0
    objects: int = 0
    far: float = math.nan


def body_of(task: ThingTask) -> Body:
    """What lies on the palms."""
    random = np.random.default_rng([_STREAM, KINDS.index(task.kind), task.seed])
    if task.kind == LUMP:
        return random_body("rig", random)
    off = OFF_CENTRE_M if task.seed % OFF_CENTRE_EVERY == OFF_CENTRE_EVERY - 1 else 0.0
    return thing(task.kind, random, off).body


def tasks_of(kinds: Iterable[str], first: int, count: int, seconds: float, imperfections: Drawn) -> list[ThingTask]:
    """So many of each kind, all with the same seeds."""
    return [ThingTask(kind, first + i, seconds, imperfections) for i in range(count) for kind in kinds]


def failed(task: ThingTask, error: BaseException) -> ThingRow:
    """The row of a run that came to nothing."""
    return ThingRow(task.kind, task.seed, error=f"{type(error).__name__}: {error}")


@with_failures(failed)
def run(task: ThingTask) -> ThingRow:
    """Move, estimate and compare; what raises becomes a row that says so."""
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
        if SHAPE.name in instant.messages:
            scorer.take_shape(instant.messages[SHAPE.name])
    outline = scorer.outline(wireless.world.object_truth()["h_m"])
    status = wireless.world.status()
    return ThingRow(
        kind=task.kind,
        seed=task.seed,
        valid=valid / ticks,
        wrong=wrong / ticks,
        most_m=most if valid else math.nan,
        e_h_m=math.nan if outline is None else outline.e_h,
        refusals=refusals,
        losses=int(status["contact_losses"] - before),
        falls=int(status["falls"]),
        objects=int(scorer.estimate["object"]),
        far=far / ticks,
    )


def _replayed(task: ThingTask) -> ThingRow:
    logged = thing_logs.SharpTask(task.kind, task.seed, task.seconds, task.imperfections)
    log, truth, _ = thing_logs.simulated(logged)
    live = answers(log, truth, make("shape", log.rig, smoothing=Simulated(log.rig)))
    misses = np.abs(live.r_error)
    error = misses.max(axis=1)
    return ThingRow(
        kind=task.kind,
        seed=task.seed,
        valid=float(live.valid.mean()),
        wrong=float(live.wrong.mean()),
        most_m=float(error[live.valid].max()) if live.valid.any() else math.nan,
        far=float((live.valid & (misses > FAR * live.r_sd).any(axis=1)).mean()),
    )


def table(rows: Sequence[ThingRow]) -> str:
    """A line for each kind, and one for all that are no smooth lump."""
    lines: list[tuple[str, Sequence[str]]] = [("", HEAD)]
    groups = [(kind, [row for row in rows if row.kind == kind and not row.error]) for kind in KINDS]
    groups.append(("all things", [row for row in rows if row.kind != LUMP and not row.error]))
    lines += [(name, _cells(mine)) for name, mine in groups if mine]
    return aligned(lines)


def _cells(rows: Sequence[ThingRow]) -> Sequence[str]:
    most = [row.most_m for row in rows if math.isfinite(row.most_m)]
    return (
        str(len(rows)),
        f"{np.mean([row.valid for row in rows]):.0%}",
        f"{np.mean([row.wrong for row in rows]):.1%}",
        f"{max(row.wrong for row in rows):.1%}",
        f"{np.mean([row.far for row in rows]):.1%}",
        f"{1e3 * max(most):.2f}" if most else "–",
        str(sum(row.refusals for row in rows)),
        str(sum(row.losses for row in rows)),
    )


def remarks(rows: Sequence[ThingRow]) -> list[str]:
    """A line for each run that came to nothing, or was valid and wrong for more than a hundredth of its ticks."""
    said = []
    for row in rows:
        if row.error:
            said.append(f"{row.kind} {row.seed}: {row.error}")
        elif row.wrong > MUCH:
            said.append(f"{row.kind} {row.seed}: wrong for {row.wrong:.1%}, by up to {1e3 * row.most_m:.2f} mm")
    return said
