"""Logs of bodies with corners, flat sides and dents, and of dry friction: how many `reconstruct` is right about.

Simulated, each from its kind and seed, on rocking palms or moved by a plan in the emulated rig, and reconstructed
blind, as `palmd reconstruct` does. What lies in a dent no palm feels: the truth of a dented body is its hull. `run`
gives the same row in any process and in any order.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
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
from palmd.record.eventlog import EventLog, read_log
from palmd.rig.dry_plant import DRY
from palmd.rig.plant import FrictionSurface, PlantOptions
from palmd.rig.shapes import Body, Support, random_body
from palmd.rig.simulate import CALIBRATION, Line, simulate_log
from palmd.rig.world import default_config
from palmd.score import score_outline
from palmd.system import vibration
from palmd.yamlfile import ConfigError, load_plan
from tools.studies import harness
from tools.studies.cells import Cell, among, count_of, most, quantiles
from tools.studies.exploring_plans import plan
from tools.studies.exploring_watch import ExplorationWatch
from tools.studies.harness import Study, result
from tools.studies.real_things import Random, thing
from tools.studies.scoring import FAR, RIGHT_M
from tools.studies.sharp_shapes import FLAT_RAD, ChordSupport, rounded_polygon, uniform_body
from tools.studies.silent_observer import SilentObserver
from tools.studies.simulated import written
from tools.wireless import Wireless

_STREAM = 31  # keeps the bodies' random numbers apart from those of the motion


def _polygon(random: Random, radius: float) -> Body:
    """Five to seven corners of this radius (m), about evenly spread, 14 to 21 mm from the middle."""
    mass, corners = float(random.uniform(0.05, 0.25)), int(random.integers(5, 8))
    angles = (np.arange(corners) + random.uniform(-0.25, 0.25, corners)) * (math.tau / corners)
    reach = random.uniform(15e-3, 20e-3) * random.uniform(0.92, 1.08, corners) - radius
    ring = [(r * math.cos(a), r * math.sin(a)) for r, a in zip(reach.tolist(), angles.tolist(), strict=True)]
    return uniform_body("polygon", rounded_polygon(ring, radius), mass)


def _dented(random: Random, chord: float) -> Body:
    """The hull of an ellipse with a dent in its long side, on which it comes to rest: a chord of this length (m)."""
    mean, flat = float(random.uniform(17e-3, 21e-3)), float(random.uniform(0.5e-3, 1.2e-3))
    lump = Support.from_coefficients((complex(mean), 0j, complex(flat), complex(random.uniform(0.0, 3e-4))))
    hull = ChordSupport(lump, math.pi / 2 + float(random.uniform(-0.15, 0.15)), chord, FLAT_RAD)
    return uniform_body("dented lump", hull, float(random.uniform(0.05, 0.25)))


def _lump(random: Random) -> Body:
    return random_body("friction", random)


def _thing(name: str) -> Callable[[Random], Body]:
    return lambda random: thing(name, random).body


BODIES: Mapping[str, Callable[[Random], Body]] = {
    "corners of 3 mm": lambda random: _polygon(random, 3e-3),
    "corners of 1 mm": lambda random: _polygon(random, 1e-3),
    "dent of 4 mm": lambda random: _dented(random, 4e-3),
    "dent of 10 mm": lambda random: _dented(random, 10e-3),
    "dry lump": _lump,
    **{name: _thing(name) for name in ("die", "nut", "triangle", "block", "D-profile", "L-profile")},
}
"""What is drawn for each kind. A dry one is rubbed by Coulomb's friction, with no dither."""

KINDS: tuple[str, ...] = tuple(BODIES)
_DRY = "dry"


@dataclass(frozen=True, slots=True)
class SharpTask:
    """One log to make and to reconstruct: what lies on the palms, the seed, how long (s).

    plan: what the palms do in the emulated rig; None: they rock, and scenes in which a contact is lost are drawn again.
    """

    kind: str
    seed: int
    seconds: float = 20.0
    imperfections: DrawnImperfections = "none"
    plan: PlanSpec | None = None


@dataclass(frozen=True, slots=True)
class SharpRow(SharpTask):
    """What came of it; NaN for what there is not.

    e_h, most, sd: RMS and largest error, and RMS of the one-sigma, over the touched normals (m). touched: their share.
    shown: the share that a recording's object was really touched by.
    explained_s: how much of the log the answer explains; mass_z: by how many one-sigmas the mass is too large.
    took_s: of the processor.
    """

    error: str = ""
    claimed: bool = False
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
        """Whether what is claimed is right to `RIGHT_M`."""
        return self.claimed and self.e_h_m < RIGHT_M

    @property
    def rough(self) -> bool:
        """Whether it is not, but no farther off than its band allows on a rig that is not as described."""
        return self.claimed and not self.right and self.imperfections != "none" and self.e_h_m < FAR * self.sd_m

    @property
    def wrong(self) -> bool:
        """Whether what is claimed is neither."""
        return self.claimed and not self.right and not self.rough


def run(task: SharpTask) -> SharpRow:
    """Simulate, reconstruct, compare."""
    log, truth, shown = simulated(task)
    begun = time.process_time()
    answer = reconstruct(log.events, log.rig)
    row = result(SharpRow, task, reason=answer.reason, took_s=time.process_time() - begun, shown=shown)
    if not answer.converged or answer.h is None or answer.h_sd is None or answer.touched is None:
        return row
    score = score_outline(answer.theta, answer.h, answer.touched, np.array(truth["h_m"]))
    return replace(
        row,
        claimed=True,
        e_h_m=score.e_h,
        most_m=score.max_error,
        sd_m=float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2))),
        touched=score.touched,
        sides=len(answer.sides),
        explained_s=answer.lasts,
        mass_z=(answer.mass - truth["mass_kg"]) / answer.mass_sd,
        looks_like=answer.shape_class.said or answer.shape_class.why,
    )


def simulated(task: SharpTask) -> ThingRecording:
    """The task's log, as it is read from a file, or its recording, and the truth."""
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
    with written(lines) as path:
        return ThingRecording(read_log(path), truth, math.nan)


LOG_S = 20.0  # how long each lasts


def draw(arguments: argparse.Namespace) -> Sequence[SharpTask]:
    """So many of each kind, all with the same seeds; CliError with all that is wrong with a plan."""
    seconds = arguments.seconds or LOG_S
    moves = _moves(arguments.plan, seconds) if arguments.explored or arguments.plan is not None else None
    return [
        SharpTask(kind, seed, seconds, arguments.imperfections, moves)
        for seed in harness.seeds_of(arguments)
        for kind in harness.kinds_of(arguments, KINDS)
    ]


def _moves(path: Path | None, seconds: float) -> PlanSpec:
    """The plan in a file, None: an exploration that takes so long."""
    config = default_config()
    if path is None:
        return plan("explore", config, ExploreGoal(coverage=1.0, time_limit_s=seconds), seed=0)
    try:
        read_plan(path, motion_limits(config), None)
        return load_plan(path)
    except ConfigError as error:
        raise CliError(BAD_INPUT, str(error)) from None


def verdict(row: SharpRow) -> str:
    """Right, in its band, wrong, or rejected."""
    if not row.claimed:
        return "rejected"
    return "right" if row.right else "in its band" if row.rough else "wrong"


def remarks(rows: Sequence[SharpRow]) -> list[str]:
    """A line for each log: what came of it, and what it looks like."""
    said = []
    for row in rows:
        shown = "" if math.isnan(row.shown) else f" ({row.shown:.0%} shown)"
        name = f"{row.kind} {row.seed}"
        if row.error or not row.claimed:
            said.append(f"{name}: {row.error or 'rejected: ' + row.reason}{shown}")
        else:
            said.append(
                f"{name}: {verdict(row)}, {1e6 * row.e_h_m:.0f} µm (largest {1e6 * row.most_m:.0f}), sd"
                f" {1e6 * row.sd_m:.0f} µm, {row.touched:.0%} touched{shown}, {row.explained_s:.1f} s explained, sides:"
                f" {row.sides}, mass {row.mass_z:+.1f} sd, {row.took_s:.0f} s; {row.looks_like}"
            )
    return said


def _verdict(which: str) -> tuple[str, Cell]:
    return which, count_of(lambda row: verdict(row) == which)


def _claimed(cell: Cell) -> Cell:
    return among(lambda row: row.claimed, cell)


OFFLINE = Study(
    "logs",
    draw,
    run,
    SharpRow,
    order=lambda row: (KINDS.index(row.kind), row.seed),
    by=lambda row: row.kind,
    columns=[
        *map(_verdict, ("right", "in its band", "wrong", "rejected")),
        ("µm", _claimed(quantiles(lambda row: row.e_h_m, 1e6))),
        ("largest", _claimed(most(lambda row: row.most_m, 1e6))),
        ("error / sd: median, most", _claimed(quantiles(lambda row: row.e_h_m / row.sd_m, 1.0, (0.5, 1.0)))),
        ("touched %", _claimed(quantiles(lambda row: row.touched, 100.0))),
        ("explained (s)", _claimed(quantiles(lambda row: row.explained_s))),
        ("processor (s): median, most", quantiles(lambda row: row.took_s, 1.0, (0.5, 1.0))),
    ],
    remarks=remarks,
    line=lambda row: harness.as_line(replace(row, plan=None)) | {"plan": row.plan and row.plan.name},
)


class ThingRecording(NamedTuple):
    """What the daemon was fed, the body as `rig/object` tells it, and the share of its normals that were touched."""

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
) -> ThingRecording:
    """So many seconds of the plan. One that explores does so by what the observer and its smoother find.

    Against `surface`, by default a random one. The same arguments, the same bits. Raises PlanError for a plan that
    leaves the default limits, WirelessError where the daemon does not get ready.
    """
    config = default_config(imperfections)
    rig = rig_description(config)
    explores = any(isinstance(segment, ExploreSpec) for segment in plan.segments)
    found_by = {"smoothing": Simulated(rig)} if explores else {"estimator": SilentObserver()}
    wireless = Wireless(config, plan, seed, options=options, body=body, surface=surface, **found_by)
    wireless.start()
    pads = tuple(pad.length for pad in rig.pads)
    fed = list[Event]()
    watch = ExplorationWatch(np.ones(BINS, dtype=np.bool_), pads, wireless.t)
    for instant in wireless.run(seconds):
        watch.take(instant)
        fed += events_of(instant.messages[EVENTS.name])
    return ThingRecording(EventLog(rig, tuple(fed)), wireless.world.object_truth(), watch.coverage)
