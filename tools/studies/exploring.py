"""Exploring in the rig without wires, what is unknown and what is known, beside two open-loop plans: one run.

`run` needs nothing but its task, and gives the same row in any process and in any order, but for what it says of time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from palmd.config.plans import ExploreGoal
from palmd.config.two_palms import Config, Drawn, rig_description
from palmd.daemon.exploration_requests import Decider, ExplorationAnswer, InlineExplorer, Question
from palmd.events import FloatArray, Outlook
from palmd.harness.wireless import Wireless
from palmd.model import shape
from palmd.model.stable_surface import stable_surface
from palmd.motion.check import motion_limits
from palmd.motion.reach import surface_limits
from palmd.motion.rig_information import rig_cost
from palmd.motion.rollout_predictor import BINS, Bools
from palmd.observer import Simulated
from palmd.rig.shapes import KINDS, Body, Kind
from palmd.rig.world import default_config
from palmd.yamlfile import load_config
from tools.studies.clairvoyant import Clairvoyant
from tools.studies.exploring_plans import EXPLORES, STRATEGIES, Strategy, plan
from tools.studies.exploring_watch import EDGE_M, ExplorationWatch
from tools.studies.held import HeldWatch
from tools.studies.runs import with_failures

GOAL = 1.0
"""The share of the normals to reach that the study asks for: more than it judges by, as both are counted in bins."""

HARMONICS = 20  # of true outlines; the flattest ellipses have more than the estimates
SETTLE_S = 2.0  # after the end of an exploration, for the smoother to read the rest


@dataclass(frozen=True, slots=True)
class ExploringTask:
    """One run to do: kind and seed of the object, how the palms are moved, and for how long (s)."""

    kind: Kind
    seed: int
    strategy: Strategy
    seconds: float = 60.0
    band_mm: float | None = None
    imperfections: Drawn = "none"
    config: Path | None = None
    """Of the rig, its imperfections included; None: the default one with these imperfections."""


@dataclass(frozen=True, slots=True)
class ExploringRow:
    """A run in numbers; NaN for what there is not.

    error: what was raised, then nothing else is known. reachable: share of the normals that stable poses within the
    limits show; coverage: touched share of these, curve: the same at each full second; of_all: touched share of all.
    enough_s, valid_s: when coverage was 0.95, when the estimate was first valid, from the start on; ended_s: when the
    exploration ended by itself, and the reason it gave. hausdorff, e_h: error of the last valid outline over all
    normals, largest and RMS; band: the largest sd that it claimed. open_rig: what touch would still have told of the
    rig's constants when it was last asked for a motion (RMS over the touched normals). losses: of a contact, how often;
    parted_s, edge_s: how long not both touched, and how long a contact was at a pad's end; wedged_s, pressed_s,
    most_force_m_s2, unnoticed: as `held` tells. recovered: whether at the end both touch and the estimate is valid.
    outside, refused: set-points outside the limits, and refused by the controller. decision: processor time (ms);
    seconds: processor time of the whole run (s). The estimates' numbers are told of explorations of what
    is unknown alone: plans have no smoother, and who is told the truth estimates nothing.
    """

    kind: Kind
    seed: int
    strategy: Strategy
    error: str = ""
    reachable: float = math.nan
    coverage: float = math.nan
    of_all: float = math.nan
    enough_s: float = math.nan
    valid_s: float = math.nan
    ended_s: float = math.nan
    reason: str = ""
    hausdorff_m: float = math.nan
    e_h_m: float = math.nan
    band_m: float = math.nan
    open_rig_m: float = math.nan
    losses: int = 0
    falls: int = 0
    parted_s: float = 0.0
    edge_s: float = 0.0
    wedged_s: float = 0.0
    pressed_s: float = 0.0
    most_force_m_s2: float = math.nan
    unnoticed: int = 0
    recovered: bool = True
    outside: int = 0
    refused: int = 0
    objects: int = 0
    decisions: int = 0
    decision_median_ms: float = math.nan
    decision_most_ms: float = math.nan
    seconds: float = math.nan
    curve: tuple[float, ...] = field(default=(), repr=False)

    @property
    def mishap(self) -> bool:
        """Whether a contact was lost or came to the end of a pad."""
        return self.losses > 0 or self.edge_s > 0.0


def tasks_of(
    kinds: Iterable[Kind],
    first_seed: int,
    count: int,
    seconds: float,
    band_mm: float | None = None,
    imperfections: Drawn = "none",
    config: Path | None = None,
) -> list[ExploringTask]:
    """So many objects of each kind, each with every strategy.

    No two kinds share a seed: here, where the hinge always travels, friction and rig are the same kind of thing.
    """
    return [
        ExploringTask(
            kind, first_seed + len(KINDS) * i + KINDS.index(kind), strategy, seconds, band_mm, imperfections, config
        )
        for i in range(count)
        for kind in kinds
        for strategy in STRATEGIES
    ]


def in_order(rows: Iterable[ExploringRow]) -> list[ExploringRow]:
    """By kind, seed and strategy, whichever was finished first."""
    return sorted(rows, key=lambda row: (KINDS.index(row.kind), row.seed, STRATEGIES.index(row.strategy)))


def failed(task: ExploringTask, error: BaseException) -> ExploringRow:
    """The row of a run that came to nothing."""
    return ExploringRow(task.kind, task.seed, task.strategy, error=f"{type(error).__name__}: {error}")


@with_failures(failed)
def run(task: ExploringTask) -> ExploringRow:
    """Explore and judge; what raises becomes a row that says so."""
    return explored(task, load_config(task.config) if task.config else default_config(task.imperfections))


class _Timed(Decider):
    """A decider that notes the processor time of each decision (ms), and what is open of the rig's constants (m)."""

    spent_ms: list[float]
    open_rig_m: float

    def answer(self, question: Question) -> ExplorationAnswer:
        begin = time.process_time()
        answer = super().answer(question)
        if isinstance(question.outlook, Outlook):
            self.spent_ms.append((time.process_time() - begin) * 1e3)
            cost = rig_cost(question.outlook, question.outlook.touched)
            self.open_rig_m = math.nan if cost is None else cost.sd
        return answer


def explored(task: ExploringTask, config: Config, body: Body | None = None) -> ExploringRow:
    """One run on the rig of that configuration, with `body` on its palms or one drawn by the task's kind and seed."""
    begin = time.process_time()
    rig = rig_description(config)
    finds_out = task.strategy == "explore"
    clairvoyant = Clairvoyant() if task.strategy == "clairvoyant" else None
    goal = ExploreGoal(coverage=GOAL, band_mm=task.band_mm, time_limit_s=task.seconds)
    decider = _Timed(rig, task.seed)
    decider.spent_ms, decider.open_rig_m = [], math.nan
    wireless = Wireless(
        config,
        plan(task.strategy, config, goal, task.seed),
        task.seed,
        kind=task.kind,
        smoothing=Simulated(rig) if finds_out else None,
        explorer=InlineExplorer(decider),
        estimator=clairvoyant,
        body=body,
    )
    true_h = np.array(wireless.world.object_truth()["h_m"])
    reachable = _reachable(config, true_h)
    watch = ExplorationWatch(reachable, tuple(pad.length for pad in rig.pads), math.nan, rig.curvatures)
    if clairvoyant is not None:
        clairvoyant.world, clairvoyant.touched = wireless.world, lambda: watch.touched
    wireless.start()
    watch.t_start = wireless.t
    before = wireless.world.status()["contact_losses"]
    held = HeldWatch.of(wireless.world)
    ended_s = _watched(wireless, watch, held, task.seconds)
    status = wireless.world.status()
    told = wireless.core.exploring.told() if task.strategy in EXPLORES else None
    score = watch.outline_score(true_h) if finds_out else None
    tick_s = 1.0 / config.loop.rate_hz
    return ExploringRow(
        kind=task.kind,
        seed=task.seed,
        strategy=task.strategy,
        reachable=float(reachable.mean()),
        coverage=watch.coverage,
        of_all=float(watch.touched.mean()),
        enough_s=watch.t_enough,
        valid_s=watch.t_valid,
        ended_s=ended_s,
        reason=told["reason"] if told else "",
        hausdorff_m=score.max_error if score else math.nan,
        e_h_m=score.e_h if score else math.nan,
        band_m=max(watch.shape["h_sd_m"]) if finds_out and watch.shape else math.nan,
        open_rig_m=decider.open_rig_m,
        losses=status["contact_losses"] - before,
        falls=status["falls"],
        parted_s=watch.parted * tick_s,
        edge_s=watch.at_edge * tick_s,
        wedged_s=held.wedged * tick_s,
        pressed_s=held.pressed * tick_s,
        most_force_m_s2=held.most_force,
        unnoticed=held.unnoticed,
        recovered=watch.on_both and watch.valid,
        outside=status["setpoints_outside_limits"] + status["jams"],
        refused=sum(count for name, count in status.items() if name.startswith("refused_")),
        objects=watch.objects,
        decisions=len(decider.spent_ms),
        decision_median_ms=float(np.median(decider.spent_ms)) if decider.spent_ms else math.nan,
        decision_most_ms=max(decider.spent_ms, default=math.nan),
        seconds=time.process_time() - begin,
        curve=tuple(watch.curve + watch.curve[-1:] * (math.floor(task.seconds) + 1 - len(watch.curve))),
    )


def _watched(wireless: Wireless, watch: ExplorationWatch, held: HeldWatch, seconds: float) -> float:
    """Let it run, no longer than something happens; when the exploration ended (s since the start), else NaN."""
    exploring, ended = False, math.nan
    for instant in wireless.run(seconds):
        watch.take(instant)
        held.take(instant)
        explores_now = wireless.core.setpoints.exploration is not None
        if exploring and not explores_now and math.isnan(ended):
            ended = instant.t - watch.t_start
        exploring = explores_now
        if instant.t - watch.t_start > ended + SETTLE_S:
            break
    return ended


def _reachable(config: Config, true_h: FloatArray) -> Bools:
    """The bins of normals that palms touch in any stable pose of the true outline, short of the pads' ends."""
    limits = motion_limits(config)
    where = replace(surface_limits(limits), margin=EDGE_M)
    surface = stable_surface(shape.coefficients_of(true_h, HARMONICS), where, bins=BINS)
    return np.asarray(surface.reach.any(axis=0), dtype=np.bool_)
