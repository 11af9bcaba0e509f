"""Unknown objects explored on the emulated rig in simulated time, compared with random moves.

Each run puts an object, drawn by its kind and seed, on the palms of a simulated closed loop. Measured are the share of
the reachable normals that the palms touch, the time until 95 % are touched, the error of the last valid outline, and
lost contacts.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palmd.config.plans import ExploreGoal
from palmd.config.two_palms import Config, DrawnImperfections, rig_description
from palmd.console.configured import configured
from palmd.events import FloatArray
from palmd.model import shape
from palmd.model.stable_surface import stable_surface
from palmd.motion.check import motion_limits
from palmd.motion.reach import surface_limits
from palmd.motion.rollout_predictor import BINS, Bools
from palmd.observer import Simulated
from palmd.rig.shapes import KINDS, Kind
from palmd.rig.world import default_config
from palmd.yamlfile import load_config
from tools.closed_loop import TwoPalmsLoop
from tools.studies import harness
from tools.studies.cells import Cell, count, errors, percent, quantile, quantiles, runs, shares
from tools.studies.exploration_plans import STRATEGIES, Strategy, plan
from tools.studies.exploration_statistics import EDGE_M, ExplorationStatistics
from tools.studies.harness import Study, result

GOAL = 1.0
"""Coverage requested of the explorer: more than `ENOUGH`, since both are counted in bins."""

HARMONICS = 20  # of true outlines; the flattest ellipses have more than the estimates
SETTLE_S = 2.0  # after the end of an exploration, for the smoother to process the last readings


@dataclass(frozen=True, slots=True)
class ExploringTask:
    """One run: kind and seed of the object, strategy of the palms' motion, duration (s)."""

    kind: Kind
    seed: int
    strategy: Strategy
    seconds: float = 60.0
    imperfections: DrawnImperfections = "none"
    config: Path | None = None
    """The rig's configuration with its imperfections; None: the default rig with `imperfections`."""


@dataclass(frozen=True, slots=True)
class ExploringRow(ExploringTask):
    """The results of one run; NaN for missing values.

    error: the exception, without any other result. reachable: share of the normals that are reachable in stable poses
    within the limits; coverage: share of these that was touched. enough_s, valid_s: time from the start to coverage
    0.95 and to the first valid estimate; ended_s: when the explorer ended the exploration, with its reason.
    hausdorff_m, e_h_m: largest and RMS error of the last valid outline over all normals; band_m: its largest 1σ;
    sigmas: largest error over the 1σ at its normal.
    losses: number of lost contacts; parted_s, edge_s: time without both contacts, and with a contact at a pad's end;
    recovered: at the end both palms are touched and the estimate is valid. outside, refused: number of set-points
    outside the limits, and refused by the controller. took_s: processor time of the whole run (s). Only explorations
    have estimates: random moves have no smoother.
    """

    error: str = ""
    reachable: float = math.nan
    coverage: float = math.nan
    enough_s: float = math.nan
    valid_s: float = math.nan
    ended_s: float = math.nan
    reason: str = ""
    hausdorff_m: float = math.nan
    e_h_m: float = math.nan
    band_m: float = math.nan
    sigmas: float = math.nan
    losses: int = 0
    parted_s: float = 0.0
    edge_s: float = 0.0
    recovered: bool = True
    outside: int = 0
    refused: int = 0
    took_s: float = math.nan

    @property
    def contact_lost(self) -> bool:
        """Whether a contact was lost or reached the end of a pad."""
        return self.losses > 0 or self.edge_s > 0.0


def run(task: ExploringTask) -> ExploringRow:
    """Explore and score."""
    begin = time.process_time()
    config = load_config(task.config) if task.config else default_config(task.imperfections)
    rig = rig_description(config)
    explores = task.strategy == "explore"
    goal = ExploreGoal(coverage=GOAL, time_limit_s=task.seconds)
    loop = TwoPalmsLoop(
        config,
        plan(task.strategy, config, goal, task.seed),
        task.seed,
        kind=task.kind,
        smoothing=Simulated(rig) if explores else None,
    )
    true_h = np.array(loop.world.object_truth()["h_m"])
    reachable = _reachable(config, true_h)
    watch = ExplorationStatistics(reachable, tuple(pad.length for pad in rig.pads), math.nan, rig.curvatures)
    loop.start()
    watch.t_start = loop.t
    before = loop.world.status()["contact_losses"]
    ended_s = _watched(loop, watch, task.seconds)
    status = loop.world.status()
    summary = (loop.core.exploring.summary() if explores else None) or {"reason": ""}
    score = watch.outline_score(true_h) if explores else None
    tick_s = 1.0 / config.loop.rate_hz
    return result(
        ExploringRow,
        task,
        reachable=float(reachable.mean()),
        coverage=watch.coverage,
        enough_s=watch.t_enough,
        valid_s=watch.t_valid,
        ended_s=ended_s,
        reason=summary["reason"],
        hausdorff_m=score.max_error if score else math.nan,
        e_h_m=score.e_h if score else math.nan,
        band_m=max(watch.shape["h_sd_m"]) if explores and watch.shape else math.nan,
        sigmas=watch.largest_sigmas(true_h) if explores else math.nan,
        losses=status["contact_losses"] - before,
        parted_s=watch.parted * tick_s,
        edge_s=watch.at_edge * tick_s,
        recovered=watch.on_both and watch.valid,
        outside=status["setpoints_outside_limits"] + status["jams"],
        refused=sum(count for name, count in status.items() if name.startswith("refused_")),
        took_s=time.process_time() - begin,
    )


def _watched(loop: TwoPalmsLoop, watch: ExplorationStatistics, seconds: float) -> float:
    """Run until `SETTLE_S` after the exploration ended; returns its end (s since the start), NaN without one."""
    exploring, ended = False, math.nan
    for instant in loop.run(seconds):
        watch.take(instant)
        explores_now = loop.core.setpoints.exploration is not None
        if exploring and not explores_now and math.isnan(ended):
            ended = instant.t - watch.t_start
        exploring = explores_now
        if instant.t - watch.t_start > ended + SETTLE_S:
            break
    return ended


def _reachable(config: Config, true_h: FloatArray) -> Bools:
    """The bins of normals that palms can touch in stable poses of the true outline, not counting the pads' ends."""
    limits = motion_limits(config)
    where = replace(surface_limits(limits), margin=EDGE_M)
    return stable_surface(shape.coefficients_of(true_h, HARMONICS), where, bins=BINS).reach


# ---------------------------------------------------------------------------------------------------- the study


def draw(arguments: argparse.Namespace) -> Sequence[ExploringTask]:
    """The requested number of objects of each kind, each with every strategy; CliError for a bad configuration.

    No two kinds share a seed: with the travelling hinge of this study the kinds `friction` and `rig` are the same.
    """
    if arguments.config is not None:
        configured(arguments.config)
    rest = arguments.seconds, arguments.imperfections, arguments.config
    return [
        ExploringTask(kind, arguments.seed + len(KINDS) * i + KINDS.index(kind), strategy, *rest)
        for i in range(arguments.runs)
        for kind in harness.kinds_of(arguments, KINDS)
        for strategy in STRATEGIES
    ]


def remark(row: ExploringRow) -> str:
    """On an exploration with too little coverage, a lost contact or a refused set-point."""
    if row.strategy != "explore":
        return ""
    parts = []
    if math.isnan(row.enough_s):
        parts.append(f"touched {row.coverage:.0%} of the {row.reachable:.0%} that can be reached ({row.reason})")
    if row.contact_lost:
        parts.append(
            f"contact lost {row.losses} times, {row.parted_s:.2f} s; at a pad's end for {row.edge_s:.2f} s"
            + ("" if row.recovered else "; not recovered")
        )
    if row.outside or row.refused:
        parts.append(f"{row.outside} set-points outside the limits, {row.refused} refused")
    return ", ".join(parts)


def two(value: Callable[[ExploringRow], float], unit: float = 1.0) -> Cell:
    """Median and 90th percentile; a run without the value counts as infinite."""
    return quantiles(value, unit, (0.5, 0.9), worst=True)


def _in_the_end(rows: Sequence[ExploringRow]) -> str:
    """Median and 10th percentile of the coverage; a failed run counts as 0."""
    touched = [0.0 if math.isnan(row.coverage) else row.coverage for row in rows]
    return " / ".join(percent(quantile(touched, q)) for q in (0.5, 0.1))


COLUMNS: list[tuple[str, Cell]] = [
    ("objects", runs),
    ("ended in an error", errors),
    ("touched 95 % (% of objects)", shares(lambda row: math.isfinite(row.enough_s))),
    ("time to 95 %, median / p90 (s)", two(lambda row: row.enough_s)),
    ("touched in the end, median / p10 (%)", _in_the_end),
    ("first valid after, median / p90 (s)", two(lambda row: row.valid_s)),
    ("ended by itself after, median / p90 (s)", two(lambda row: row.ended_s)),
    ("whole outline: largest error, median / p90 (mm)", two(lambda row: row.hausdorff_m, 1e3)),
    ("whole outline: RMS, median / p90 (µm)", two(lambda row: row.e_h_m, 1e6)),
    ("whole outline: largest error / 1σ, median / p90", two(lambda row: row.sigmas)),
    ("contact lost or pad's end reached (runs)", count(lambda row: row.contact_lost)),
    ("of these not recovered", count(lambda row: row.contact_lost and not row.recovered)),
    ("limits or workspace violated (runs)", count(lambda row: row.outside + row.refused > 0)),
    ("processor time of a run, median / p90 (s)", two(lambda row: row.took_s)),
]

STUDY = Study(
    "explore",
    draw,
    run,
    ExploringRow,
    order=lambda row: (KINDS.index(row.kind), STRATEGIES.index(row.strategy), row.seed),
    by=lambda row: row.kind if row.strategy == "explore" else f"{row.kind}, {row.strategy}",
    columns=COLUMNS,
    across=True,
    remark=remark,
    panels=[
        ("time to 95 % of what can be reached (s)", lambda row: row.enough_s, 1.0, (), False),
        ("touched of what can be reached in the end (%)", lambda row: row.coverage, 100.0, (), False),
        ("first valid after (s)", lambda row: row.valid_s, 1.0, (), False),
        ("whole outline: RMS error (µm)", lambda row: row.e_h_m, 1e6, (), True),
    ],
    line=lambda row: harness.as_line(row) | {"config": row.config and str(row.config)},
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(parser, runs=10, seconds_each=60.0, output="explore", kinds=KINDS)
    harness.add_imperfections(parser)
    parser.add_argument("--config", type=Path, help="the rig, with its imperfections; default: VersaPads and an arm")
