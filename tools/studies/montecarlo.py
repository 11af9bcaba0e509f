"""Blind reconstruction of random objects in random motion: one run, by its kind and seed.

`run` needs nothing but its task and touches nothing but a temporary file, so that it gives the same row in any
process, on any machine and in any order.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from palmd import observer
from palmd.config.two_palms import Drawn
from palmd.events import FloatArray, ShapeEstimate
from palmd.observer.bound import cramer_rao
from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import EventLog
from palmd.record.replay import replay
from palmd.rig.shapes import KINDS, Kind
from tools.studies.runs import with_failures
from tools.studies.scoring import (
    Line,
    MonteCarloRow,
    ObserverAnswers,
    causal_of,
    outline_errors,
    row_of,
    score_where_known,
    truth_of,
)
from tools.studies.simulated import simulated

TICKS_PER_SHAPE = 10


@dataclass(frozen=True, slots=True)
class MonteCarloTask:
    """One run to do: as `simulated` takes it, lasting so many seconds, and whether to replay it causally too."""

    kind: Kind
    seed: int
    seconds: float = 10.0
    causal: bool = True
    imperfections: Drawn = "none"


def tasks_of(
    kinds: Iterable[Kind], first_seed: int, runs: int, seconds: float, causal: bool, imperfections: Drawn = "none"
) -> list[MonteCarloTask]:
    """So many runs of each kind, all kinds with the same seeds."""
    return [MonteCarloTask(kind, first_seed + i, seconds, causal, imperfections) for i in range(runs) for kind in kinds]


def failed(task: MonteCarloTask, error: BaseException) -> MonteCarloRow:
    """The row of a run that came to nothing."""
    return MonteCarloRow(task.kind, task.seed, error=f"{type(error).__name__}: {error}")


@with_failures(failed)
def run(task: MonteCarloTask) -> MonteCarloRow:
    """Simulate, reconstruct, replay and score; what raises becomes a row that says so."""
    log, told = simulated(task.kind, task.seed, task.seconds, imperfections=task.imperfections)
    truth = truth_of(told)
    # The estimators' own seeds stay at their defaults, so that the commands give the same answers on the same log.
    answer = reconstruct(log.events, log.rig)
    outline = outline_errors(answer, truth)
    bound = cramer_rao(log.events, log.rig, truth, truth.theta if outline is None else outline.true_theta)
    watcher = observer.make("shape", log.rig, smoothing=observer.Simulated(log.rig))
    causal = causal_of(answers(log, told, watcher)) if task.causal else None
    return row_of(task.kind, task.seed, truth, answer, outline, bound, causal)


def in_order(rows: Iterable[MonteCarloRow]) -> list[MonteCarloRow]:
    """By kind and seed, whichever was finished first."""
    return sorted(rows, key=lambda row: (KINDS.index(row.kind), row.seed))


def answers(log: EventLog, told: Line, watcher: observer.Observer) -> ObserverAnswers:
    """Everything that the observer says of the run, tick by tick, against the truth that was `told`."""
    true_h = np.array(told["h_m"])
    t, valid, r, sd, e_h, latest = [], [], [], [], [], math.nan
    for tick in replay(log, watcher):
        if tick.number % TICKS_PER_SHAPE == 0:
            latest = _e_h(watcher.shape(tick.t), true_h)
        estimate = tick.estimate
        t.append(tick.t)
        valid.append(estimate.valid)
        r.append((estimate.r1, estimate.r2))
        sd.append((estimate.sd["r1"], estimate.sd["r2"]))
        e_h.append(latest)
    times = np.array(t)
    true_r = np.column_stack([np.interp(times, told["t"], told[name]) for name in ("r1_m", "r2_m")])
    return ObserverAnswers(
        t=times - log.events[0].t_sample,
        valid=np.array(valid, dtype=np.bool_),
        r_error=np.array(r) - true_r,
        r_sd=np.array(sd),
        e_h=np.array(e_h),
    )


def _e_h(shape: ShapeEstimate | None, true_h: FloatArray) -> float:
    score = shape and score_where_known(shape.theta, shape.h, shape.touched, true_h)
    return score.e_h if score else math.nan
