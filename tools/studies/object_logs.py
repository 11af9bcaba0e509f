"""Logs of bodies with corners, flat sides and dents, and with dry friction: how many `reconstruct` gets right.

Each log is simulated from its kind and seed, on rocking palms or moved by a plan in the emulated rig, and reconstructed
blind, as by `palmd reconstruct`. A palm cannot touch the inside of a dent: the truth of a dented body is its hull.
`run` gives the same row in any process and in any order.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from palmd.config.plans import ExploreGoal, ExploreSpec
from palmd.config.two_palms import DrawnImperfections, PlanSpec, rig_description
from palmd.console.errors import BAD_INPUT, CliError
from palmd.daemon.planner import read_plan
from palmd.events import Event
from palmd.messages import events_of
from palmd.motion.check import motion_limits
from palmd.motion.rollout_predictor import BINS
from palmd.observer import Simulated
from palmd.observer.reconstruct import reconstruct
from palmd.quantities import EVENTS
from palmd.record.eventlog import EventLog
from palmd.rig.dry_plant import DRY
from palmd.rig.plant import FrictionSurface, PlantOptions
from palmd.rig.shapes import Body, Support, random_body
from palmd.rig.simulate import CALIBRATION, Line, simulate_log
from palmd.rig.world import default_config
from palmd.score import score_outline
from palmd.system import vibration
from palmd.yamlfile import ConfigError, load_plan
from tools.closed_loop import TwoPalmsLoop
from tools.studies import harness
from tools.studies.cells import accepted, count_of, most, quantiles
from tools.studies.exploration_plans import plan
from tools.studies.exploration_statistics import ExplorationStatistics
from tools.studies.harness import Study, result
from tools.studies.real_objects import Random, real_object
from tools.studies.scoring import FAR, RIGHT_M, rms
from tools.studies.sharp_shapes import FLAT_RAD, ChordSupport, rounded_polygon, uniform_body
from tools.studies.simulated import log_of
from tools.studies.stub_observers import EmptyObserver

_STREAM = 31  # random stream of the bodies, distinct from the motion's


def _polygon(random: Random, radius: float) -> Body:
    """A polygon with five to seven corners of this radius (m), nearly evenly spaced, 14 to 21 mm from the middle."""
    mass, corners = float(random.uniform(0.05, 0.25)), int(random.integers(5, 8))
    angles = (np.arange(corners) + random.uniform(-0.25, 0.25, corners)) * (math.tau / corners)
    reach = random.uniform(15e-3, 20e-3) * random.uniform(0.92, 1.08, corners) - radius
    ring = [(r * math.cos(a), r * math.sin(a)) for r, a in zip(reach.tolist(), angles.tolist(), strict=True)]
    return uniform_body("polygon", rounded_polygon(ring, radius), mass)


def _dented(random: Random, chord: float) -> Body:
    """The hull of an ellipse with a dent in its long side, on which it can rest: a chord of this length (m)."""
    mean, flat = float(random.uniform(17e-3, 21e-3)), float(random.uniform(0.5e-3, 1.2e-3))
    lump = Support.from_coefficients((complex(mean), 0j, complex(flat), complex(random.uniform(0.0, 3e-4))))
    hull = ChordSupport(lump, math.pi / 2 + float(random.uniform(-0.15, 0.15)), chord, FLAT_RAD)
    return uniform_body("dented lump", hull, float(random.uniform(0.05, 0.25)))


def _real(name: str, random: Random) -> Body:
    return real_object(name, random).body


BODIES: Mapping[str, Callable[[Random], Body]] = {
    "corners of 3 mm": lambda random: _polygon(random, 3e-3),
    "corners of 1 mm": lambda random: _polygon(random, 1e-3),
    "dent of 4 mm": lambda random: _dented(random, 4e-3),
    "dent of 10 mm": lambda random: _dented(random, 10e-3),
    "dry lump": partial(random_body, "friction"),
    **{name: partial(_real, name) for name in ("die", "nut", "triangle", "block", "D-profile", "L-profile")},
}
"""For each kind a function that draws its body. Dry kinds have Coulomb friction without dither."""

KINDS: tuple[str, ...] = tuple(BODIES)
_DRY = "dry"


@dataclass(frozen=True, slots=True)
class SharpTask:
    """One log: kind of object, seed, duration (s).

    plan: of the palms in the emulated rig; None: they rock, and scenes in which a contact is lost are drawn again.
    """

    kind: str
    seed: int
    seconds: float = 20.0
    imperfections: DrawnImperfections = "none"
    plan: PlanSpec | None = None


@dataclass(frozen=True, slots=True)
class SharpRow(SharpTask):
    """The results of one log; NaN for missing values. accepted: whether the reconstruction is accepted.

    e_h_m, most_m, sd_m: RMS and largest error, and RMS of 1σ, over the touched normals. touched: their share. shown:
    the true coverage in a recording. explained_s: explained duration of the log; mass_z: error of the mass in 1σ.
    took_s: processor time.
    """

    error: str = ""
    accepted: bool = False
    reason: str = ""
    e_h_m: float = math.nan
    most_m: float = math.nan
    sd_m: float = math.nan
    touched: float = math.nan
    shown: float = math.nan
    sides: int = 0
    explained_s: float = math.nan
    mass_z: float = math.nan
    took_s: float = math.nan
    looks_like: str = ""

    @property
    def right(self) -> bool:
        """Whether the estimate is accepted and its RMS error is below `RIGHT_M`."""
        return self.accepted and self.e_h_m < RIGHT_M

    @property
    def rough(self) -> bool:
        """Whether it is accepted and not right, but within `FAR` 1σ on a rig with imperfections."""
        return self.accepted and not self.right and self.imperfections != "none" and self.e_h_m < FAR * self.sd_m

    @property
    def wrong(self) -> bool:
        """Whether it is accepted and neither right nor rough."""
        return self.accepted and not self.right and not self.rough


def run(task: SharpTask) -> SharpRow:
    """Simulate, reconstruct, compare."""
    log, truth, shown = simulated(task)
    t_cpu = time.process_time()
    answer = reconstruct(log.events, log.rig)
    row = result(SharpRow, task, reason=answer.reason, took_s=time.process_time() - t_cpu, shown=shown)
    if not answer.converged or answer.h is None or answer.h_sd is None or answer.touched is None:
        return row
    score = score_outline(answer.theta, answer.h, answer.touched, np.array(truth["h_m"]))
    return replace(
        row,
        accepted=True,
        e_h_m=score.e_h,
        most_m=score.max_error,
        sd_m=rms(answer.h_sd[answer.touched]),
        touched=score.touched,
        sides=len(answer.sides),
        explained_s=answer.lasts,
        mass_z=(answer.mass - truth["mass_kg"]) / answer.mass_sd,
        looks_like=answer.shape_class.text or answer.shape_class.why,
    )


def simulated(task: SharpTask) -> ObjectRecording:
    """The task's log as read from a file, or its recording, with the truth."""
    body = BODIES[task.kind](np.random.default_rng([_STREAM, KINDS.index(task.kind), task.seed]))
    dry = task.kind.startswith(_DRY)
    options, surface = PlantOptions(friction_law="coulomb" if dry else None), DRY if dry else None
    if task.plan is not None:
        return recorded(body, task.plan, task.seed, task.seconds, task.imperfections, options, surface)
    sds = CALIBRATION[task.imperfections]
    lines, truth = simulate_log(
        "friction", task.seed, task.seconds, options, body,
        surface=surface, calibration_sd=sds, vibration=vibration.DRY if dry else vibration.INDEPENDENT,
    )  # fmt: skip
    return ObjectRecording(log_of(lines), truth, math.nan)


LOG_S = 20.0  # duration of a log


def draw(arguments: argparse.Namespace) -> Sequence[SharpTask]:
    """The requested number of logs of each kind, all kinds with the same seeds; CliError for a bad plan."""
    seconds = arguments.seconds or LOG_S
    moves = _moves(arguments.plan, seconds) if arguments.explored or arguments.plan is not None else None
    return [
        SharpTask(kind, seed, seconds, arguments.imperfections, moves)
        for seed in harness.seeds_of(arguments)
        for kind in harness.kinds_of(arguments, KINDS)
    ]


def _moves(path: Path | None, seconds: float) -> PlanSpec:
    """The plan in a file; for None an exploration of so many seconds."""
    config = default_config()
    if path is None:
        return plan("explore", config, ExploreGoal(coverage=1.0, time_limit_s=seconds), seed=0)
    try:
        read_plan(path, motion_limits(config), None)
        return load_plan(path)
    except ConfigError as error:
        raise CliError(BAD_INPUT, str(error)) from None


VERDICTS = ("right", "in its band", "wrong", "rejected")


def verdict(row: SharpRow) -> str:
    """One of `VERDICTS`."""
    if not row.accepted:
        return "rejected"
    return "right" if row.right else "in its band" if row.rough else "wrong"


def _has(which: str, row: SharpRow) -> bool:
    return verdict(row) == which


def remark(row: SharpRow) -> str:
    """The results of a log, with its shape classification."""
    shown = "" if math.isnan(row.shown) else f" ({row.shown:.0%} shown)"
    if not row.accepted:
        return f"rejected: {row.reason}{shown}"
    return (
        f"{verdict(row)}, {1e6 * row.e_h_m:.0f} µm (largest {1e6 * row.most_m:.0f}), sd {1e6 * row.sd_m:.0f} µm,"
        f" {row.touched:.0%} touched{shown}, {row.explained_s:.1f} s explained, sides: {row.sides},"
        f" mass {row.mass_z:+.1f} sd, {row.took_s:.0f} s; {row.looks_like}"
    )


OFFLINE = Study(
    "logs",
    draw,
    run,
    SharpRow,
    order=lambda row: (KINDS.index(row.kind), row.seed),
    by=lambda row: row.kind,
    columns=[
        *((which, count_of(partial(_has, which))) for which in VERDICTS),
        ("µm", accepted(quantiles(lambda row: row.e_h_m, 1e6))),
        ("largest", accepted(most(lambda row: row.most_m, 1e6))),
        ("error / sd: median, most", accepted(quantiles(lambda row: row.e_h_m / row.sd_m, 1.0, (0.5, 1.0)))),
        ("touched %", accepted(quantiles(lambda row: row.touched, 100.0))),
        ("explained (s)", accepted(quantiles(lambda row: row.explained_s))),
        ("processor (s): median, most", quantiles(lambda row: row.took_s, 1.0, (0.5, 1.0))),
    ],
    remark=remark,
    line=lambda row: harness.as_line(replace(row, plan=None)) | {"plan": row.plan and row.plan.name},
)


class ObjectRecording(NamedTuple):
    """The daemon's input events, the body as in `rig/object`, and the share of its normals that was touched."""

    log: EventLog
    truth: Line
    shown: float


def recorded(
    body: Body,
    plan: PlanSpec,
    seed: int,
    seconds: float,
    imperfections: DrawnImperfections,
    options: PlantOptions,
    surface: FrictionSurface | None = None,
) -> ObjectRecording:
    """Record so many seconds of a plan; an exploration uses the observer and its smoother.

    `surface`: friction, by default a random one. The same arguments give identical results. Raises PlanError for a plan
    that leaves the default limits, ClosedLoopError if the daemon does not become ready.
    """
    config = default_config(imperfections)
    rig = rig_description(config)
    explores = any(isinstance(segment, ExploreSpec) for segment in plan.segments)
    estimated_by = {"smoothing": Simulated(rig)} if explores else {"estimator": EmptyObserver()}
    loop = TwoPalmsLoop(config, plan, seed, options=options, body=body, surface=surface, **estimated_by)
    loop.start()
    pads = tuple(pad.length for pad in rig.pads)
    events = list[Event]()
    watch = ExplorationStatistics(np.ones(BINS, dtype=np.bool_), pads, loop.t)
    for instant in loop.run(seconds):
        watch.take(instant)
        events += events_of(instant.messages[EVENTS.name])
    return ObjectRecording(EventLog(rig, tuple(events)), loop.world.object_truth(), watch.coverage)
