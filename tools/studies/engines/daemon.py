"""The whole daemon in closed loop, with MuJoCo or palmd's own plant in the emulated rig.

As `palmd demo --physics mujoco`, in virtual time: an ellipse drawn by the seed, vibrating palms and a rig with residual
calibration errors; the ellipse is explored until its outline is complete.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.config.two_palms import Config, PlanSpec, rig_description
from palmd.console.shipped import shipped
from palmd.harness.comparison import ObjectLosses
from palmd.harness.scorer import COMPARED, Scorer
from palmd.observer import Simulated
from palmd.rig.plant import PHYSICS, Physics, PlantOptions
from palmd.rig.shapes import Kind
from palmd.rig.world import World
from palmd.score import WRONG_M
from palmd.system.mechanism import RADII
from palmd.yamlfile import load_config, load_plan
from tools.closed_loop import TwoPalmsLoop
from tools.studies import harness
from tools.studies.cells import Cell, count, count_of, errors, percent, quantiles, runs
from tools.studies.harness import ALL, Goal, Study, result
from tools.studies.scoring import FAR

KIND: Kind = "ellipse"
TOUCHED = 0.95  # of the normals: the goal that the demo's plan explores to
_ALONE_S = 2.0  # of the rig without a daemon, to time it


@dataclass(frozen=True, slots=True)
class DaemonTask:
    """One run: plant of the emulated rig, seed of the object, duration (s)."""

    physics: Physics
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class DaemonRow(DaemonTask):
    """The results of one run; NaN for missing values.

    error: the exception, without any other result. settled_s: time from the start to the first valid estimate. touched:
    share of the normals. e_h_m, sd_m: RMS error and RMS 1σ of the last valid outline over the touched normals;
    largest_m, largest_sd_m: over all normals. valid, lost: whether there is a valid estimate at the end, and how often
    it was lost. wrong: share of valid ticks with an error of a radius above 0.3 mm. fault: the first one that held or
    stopped the palms. contact_losses: number of lost contacts. penetration_m: the engine's deepest. rig_share:
    processor time of the emulated rig alone, per second. took_s: processor time of the whole run.
    """

    error: str = ""
    settled_s: float = math.nan
    touched: float = math.nan
    e_h_m: float = math.nan
    sd_m: float = math.nan
    largest_m: float = math.nan
    largest_sd_m: float = math.nan
    valid: bool = False
    lost: int = 0
    wrong: float = math.nan
    fault: str = ""
    contact_losses: int = 0
    penetration_m: float = math.nan
    rig_share: float = math.nan
    took_s: float = math.nan

    @property
    def beyond(self) -> bool:
        """Whether the estimate is valid at the end and wrong by more than 3σ, where touched or anywhere."""
        return self.valid and (self.e_h_m > FAR * self.sd_m or self.largest_m > FAR * self.largest_sd_m)


def demo() -> tuple[Config, PlanSpec]:
    """The rig and the plan of `palmd demo`."""
    config = load_config(shipped("demo.yaml"))
    assert config.plan is not None, "it explores"
    return config, load_plan(config.plan)


def run(task: DaemonTask) -> DaemonRow:
    """Explore and score."""
    begin = time.process_time()
    (config, plan), options = demo(), PlantOptions(physics=task.physics)
    rig = rig_description(config)
    loop = TwoPalmsLoop(config, plan, task.seed, kind=KIND, options=options, smoothing=Simulated(rig))
    loop.start()
    scorer, standing, fault, wrong = Scorer(loop.t), ObjectLosses(), "", list[bool]()
    for instant in loop.run(task.seconds):
        t, estimate = instant.t, instant.messages["palm/estimate"]
        standing.take(t, bool(estimate["valid"]), int(estimate["object"]))
        if scorer.take(t, estimate):
            scorer.compare(t, *([of[name] for name in COMPARED] for of in (estimate, instant.truth)))
            off = [abs(estimate[f"{name}_m"] - instant.truth[f"{name}_m"]) for name in RADII]
            wrong.append(max(off) > WRONG_M)
        if "palm/shape" in instant.messages:
            scorer.take_shape(instant.messages["palm/shape"])
        fault = fault or next((each.code for each in loop.core.faults.active if each.severity in ("hold", "stop")), "")
    status, true_h = loop.world.status(), loop.world.object_truth()["h_m"]
    where, everywhere = scorer.outline(true_h), scorer.outline(true_h, all_normals=True)
    measured: dict[str, float] = {}
    if where is not None and everywhere is not None and scorer.shape is not None:
        sd, touched = np.array(scorer.shape["h_sd_m"]), np.array(scorer.shape["touched"]) > 0
        measured = {
            "touched": where.touched,
            "e_h_m": where.e_h,
            "sd_m": math.sqrt(np.mean(sd[touched] ** 2)),
            "largest_m": everywhere.max_error,
            "largest_sd_m": float(sd.max()),
        }
    return result(
        DaemonRow,
        task,
        settled_s=scorer.settling_s,
        valid=standing.known,
        lost=standing.losses,
        wrong=float(np.mean(wrong)) if wrong else math.nan,
        fault=fault,
        contact_losses=status["contact_losses"],
        penetration_m=status.get("penetration_m", math.nan),
        rig_share=_rig_share(config, task),
        took_s=time.process_time() - begin,
        **measured,
    )


def _rig_share(config: Config, task: DaemonTask) -> float:
    world = World(config, task.seed, kind=KIND, options=PlantOptions(physics=task.physics))
    begin = time.process_time()
    world.advance(_ALONE_S)
    return (time.process_time() - begin) / _ALONE_S


def draw(arguments: argparse.Namespace) -> Sequence[DaemonTask]:
    """Each seed with either physics, or with one."""
    asked = PHYSICS if arguments.engine == ALL else (arguments.engine,)
    return [DaemonTask(physics, seed, arguments.seconds) for seed in harness.seeds_of(arguments) for physics in asked]


def _share(value: str) -> Cell:
    return lambda rows: percent(float(np.median([getattr(row, value) for row in rows])))


def _remark(row: DaemonRow) -> str:
    parts = [
        f"touched {row.touched:.0%}",
        "valid at the end" if row.valid else "not valid at the end",
        f"RMS error {row.e_h_m * 1e6:.0f} µm, 1σ {row.sd_m * 1e6:.0f} µm ({row.e_h_m / row.sd_m:.1f}σ)",
        f"largest error {row.largest_m * 1e6:.0f} µm, largest 1σ {row.largest_sd_m * 1e6:.0f} µm",
    ]
    if row.lost or row.contact_losses:
        parts.append(f"estimate lost {row.lost} times, contacts {row.contact_losses} times")
    if math.isfinite(row.penetration_m):
        parts.append(f"penetration {row.penetration_m * 1e6:.1f} µm")
    return ", ".join([*parts, *filter(None, [row.fault])])


COLUMNS: list[tuple[str, Cell]] = [
    ("objects", runs),
    ("ended in an error", errors),
    ("touched 95 % or more", count_of(lambda row: row.touched >= TOUCHED)),
    ("valid at the end", count(lambda row: row.valid)),
    ("valid at the end and beyond 3σ", count(lambda row: row.beyond)),
    ("RMS error of the touched outline, median / p90 (µm)", quantiles(lambda row: row.e_h_m, 1e6, (0.5, 0.9))),
    ("its RMS 1σ, median / p90 (µm)", quantiles(lambda row: row.sd_m, 1e6, (0.5, 0.9))),
    ("whole outline: largest error, median / p90 (µm)", quantiles(lambda row: row.largest_m, 1e6, (0.5, 0.9))),
    ("settled after, median / p90 (s)", quantiles(lambda row: row.settled_s, 1.0, (0.5, 0.9))),
    ("deepest penetration, median / p90 (µm)", quantiles(lambda row: row.penetration_m, 1e6, (0.5, 0.9))),
    ("processor time of the rig, median (% of a core)", _share("rig_share")),
    ("processor time of a run, median / p90 (s)", quantiles(lambda row: row.took_s, 1.0, (0.5, 0.9))),
]

STUDY = Study(
    "engines-daemon",
    draw,
    run,
    DaemonRow,
    order=lambda row: (PHYSICS.index(row.physics), row.seed),
    by=lambda row: row.physics,
    columns=COLUMNS,
    across=True,
    title=lambda row: f"{row.physics} {row.seed}",
    remark=_remark,
    goals=[
        Goal("no outline that is valid at the end is beyond 3σ", lambda rows: not any(row.beyond for row in rows)),
    ],
    resumes=True,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(parser, runs=2, seconds_each=60.0, output="engines-daemon.jsonl", what="with each plant")
    parser.add_argument(
        "--engine", choices=(*PHYSICS, ALL), default=ALL, help="plant of the rig (default: %(default)s)"
    )
