"""Unknown bodies between three palms in space reconstructed blind from simulated runs, scored against their truth.

Right is a surface within 0.15 mm (RMS) of the truth within 4 degrees of where it was touched, after the best rotation.
With --live, and with --exploring, the emulated rig lives without wires and what is published is scored tick by tick.
"""

from __future__ import annotations

import argparse
import functools
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.optimize import least_squares

from palmd.blas import one_thread
from palmd.config.three_palms import ThreePalmsConfig, TiltPlanSpec
from palmd.console.shipped import shipped
from palmd.events import FloatArray
from palmd.harness.three_palms_comparison import matrix, surface_error
from palmd.model import rotation
from palmd.model.icosphere import icosphere
from palmd.model.spherical import evaluator, order_of
from palmd.motion.body_explorer import NEAR_RAD
from palmd.observer.three_palms.reconstruct import BodyReconstruction, reconstruct
from palmd.quantities import STATE
from palmd.record.systems.three_palms import SYSTEM, path_and_readings
from palmd.system.three_palms import JOINTS, PALMS, palms_at
from palmd.three_palms_quantities import PALM3, PALM3_SHAPE, WORLD_AXES
from palmd.yamlfile import load_any_config, parse, read_document
from tools.studies import harness
from tools.studies.cells import among, count, mean, quantiles, runs
from tools.studies.harness import Study, result
from tools.studies.space_logs import KINDS, simulate
from tools.wireless import ThreePalmsWireless

HALVINGS = 3  # of the directions that are counted: 642
GOAL = 0.8
MARKS_S = (20.0, 40.0, 60.0)
RIGHT_M = 1.5e-4
COMPARED = (
    *(f"omega_{axis}_rad_s" for axis in WORLD_AXES),
    *(f"com_{axis}_m" for axis in WORLD_AXES),
    *(f"{side}{palm}_m" for palm in PALMS for side in "ab"),
)


@dataclass(frozen=True, slots=True)
class SpaceLiveTask:
    """One body: its seed, how long (s), and by which shipped plan."""

    seed: int
    seconds: float
    plan: Literal["sway", "explore"] = "sway"


@dataclass(frozen=True, slots=True)
class SpaceLiveRow(SpaceLiveTask):
    """One body, live: when it was first valid, and converged (s from the first motion; NaN: never).

    valid: share of the ticks since then. surface_error: RMS of the last accepted surface where touched (m), NaN without
    one; wrong: how many accepted surfaces were not within `RIGHT_M`. ratio: mean (error/sd)² of spin, centre and
    contacts in valid ticks. coverage: the share of all directions within 10 degrees of a contact curve after each of
    `MARKS_S`; told: what was said of it in the end. losses: how often the body fell off the palms, recovered: after how
    many of them it was valid again, for `back_s` in the mean without.
    """

    error: str = ""
    settled: float = math.nan
    for_good: float = math.nan
    valid: float = math.nan
    surface_error: float = math.nan
    wrong: int = 0
    ratio: float = math.nan
    coverage: tuple[float, ...] = ()
    told: float = math.nan
    losses: int = 0
    recovered: int = 0
    back_s: float = math.nan
    reason: str = ""


class TrueCoverage:
    """What of the body has been touched in truth."""

    def __init__(self) -> None:
        self._directions = icosphere(HALVINGS)[0]
        self._touched = np.zeros(len(self._directions), np.bool_)
        self._at_marks: list[float] = []

    def see(self, since: float, truth: dict[str, Any]) -> None:
        """At so many seconds since the first motion."""
        if len(self._at_marks) < len(MARKS_S) and since >= MARKS_S[len(self._at_marks)]:
            self._at_marks.append(self.share)
        if truth["touch1"]:
            still = np.zeros((1, 3))
            joints = np.array([[truth[f"{joint}_rad"] for joint in JOINTS]])
            normals = -palms_at(joints, still, still).normal[0] @ matrix(truth["quat_xyzw"])
            self._touched |= (self._directions @ normals.T).max(axis=1) > math.cos(NEAR_RAD)

    @property
    def share(self) -> float:
        """Of all directions."""
        return float(self._touched.mean())

    @property
    def at_marks(self) -> tuple[float, ...]:
        """After each of them; the last share where it did not last so long."""
        return (*self._at_marks, *[self.share] * (len(MARKS_S) - len(self._at_marks)))


@one_thread()
def lived(task: SpaceLiveTask) -> SpaceLiveRow:
    """The shipped configuration and plan, with the body and the noise of this seed; answers come after fixed times."""
    config = load_any_config(shipped("three_palms.yaml"))
    if not isinstance(config, ThreePalmsConfig):
        raise TypeError("the shipped configuration is not of three palms in space")
    spec = parse(read_document(shipped("plans") / "three_palms" / f"{task.plan}.yaml"), TiltPlanSpec)
    rig = ThreePalmsWireless(config, spec, task.seed)
    rig.start()
    begun, settled = rig.t, math.nan
    ticks, valid, squares = 0, 0, []
    surfaces: list[tuple[float, float]] = []
    estimate: dict[str, Any] = {}
    coverage, told = TrueCoverage(), math.nan
    lost, back, losses = math.nan, list[float](), 0
    for now in rig.run(task.seconds):
        estimate, truth = now.messages[PALM3.name], now.truth
        coverage.see(rig.t - begun, truth)
        told = now.messages.get(STATE.name, {}).get("coverage", told)
        if rig.world.contact_losses > losses:
            losses, lost = rig.world.contact_losses, rig.t
        if estimate["valid"]:
            if math.isfinite(lost):
                back.append(rig.t - lost)
                lost = math.nan
            settled = rig.t - begun if math.isnan(settled) else settled
            valid += 1
            if math.isfinite(truth["a1_m"]):
                off = [(estimate[name] - truth[name]) / estimate["sd"][name] for name in COMPARED]
                squares.append(float(np.mean(np.square(off))))
        ticks += math.isfinite(settled)
        shape = now.messages.get(PALM3_SHAPE.name)
        if shape is not None and shape["valid"]:
            turn = matrix(truth["quat_xyzw"]).T @ matrix(estimate["quat_xyzw"])
            true = np.array(rig.world.object_truth()["h_m"])
            surfaces.append((rig.t - begun, surface_error(shape, true, turn)[0]))
    wrong = [t for t, error in surfaces if not error < RIGHT_M]
    right = [t for t, _ in surfaces if t > max(wrong, default=-math.inf)]
    return result(
        SpaceLiveRow,
        task,
        settled=settled,
        for_good=right[0] if right else math.nan,
        valid=valid / ticks if ticks else 0.0,
        surface_error=surfaces[-1][1] if surfaces else math.nan,
        wrong=len(wrong),
        ratio=float(np.mean(squares)) if squares else math.nan,
        coverage=coverage.at_marks,
        told=told,
        losses=losses,
        recovered=len(back),
        back_s=float(np.mean(back)) if back else math.nan,
        reason=str(estimate["reason"]),
    )


def draw_live(arguments: argparse.Namespace) -> Sequence[SpaceLiveTask]:
    """One run for each seed."""
    plan: Literal["sway", "explore"] = "explore" if arguments.exploring else "sway"
    return [SpaceLiveTask(seed, arguments.seconds, plan) for seed in harness.seeds_of(arguments)]


def remarks(rows: Sequence[SpaceLiveRow]) -> Iterator[str]:
    """A line for each."""
    for row in rows:
        if row.error:
            yield f"{row.seed:8}: {row.error}"
            continue
        lost = f", {row.recovered} times valid again after {row.back_s:.1f} s" if row.losses else ""
        yield (
            f"{row.seed:8}: valid after {row.settled:.1f} s, converged after {row.for_good:.1f} s, valid"
            f" {row.valid:.0%} of the time since, {row.surface_error * 1e6:.0f} µm, {row.wrong} wrong,"
            f" (e/sd)² {row.ratio:.2f}, fell off {row.losses} times{lost}; {row.reason or 'valid at the end'}"
        )
        if row.plan == "explore":
            shares = zip(MARKS_S, row.coverage, strict=True)
            touched = ", ".join(f"{share:.0%} after {mark:.0f} s" for mark, share in shares)
            yield f"{row.seed:8}: touched {touched}, published {row.told:.0%}"


def _touched(row: SpaceLiveRow) -> float:
    return row.coverage[-1] if row.coverage else math.nan


LIVE = Study(
    "three palms, live",
    draw_live,
    lived,
    SpaceLiveRow,
    order=lambda row: row.seed,
    by=lambda row: row.plan,
    columns=[
        ("bodies", runs),
        ("valid once", count(lambda row: math.isfinite(row.settled))),
        ("converged", count(lambda row: math.isfinite(row.for_good))),
        ("after, s", quantiles(lambda row: row.for_good)),
        ("ever wrong", count(lambda row: row.wrong > 0)),
        ("fell off", count(lambda row: row.losses > 0)),
        ("touched, %", quantiles(_touched, 100.0)),
        (f"touched {GOAL:.0%}", count(lambda row: _touched(row) >= GOAL)),
    ],
    remarks=remarks,
)


NEAR_DEG = 4.0


@dataclass(frozen=True, slots=True)
class SpaceTask:
    """One body of so many that are drawn together by one seed, what sort of run, and how long (s)."""

    kind: str
    seed: int
    bodies: int
    body: int
    seconds: float


@dataclass(frozen=True, slots=True)
class SpaceRow(SpaceTask):
    """One run: whether it converged and was right, its errors (m), how they compare with the bands, and the time taken.

    h_error: RMS of h within `NEAR_DEG` of the contact curves after the best rotation; ratio: mean of (error/sd)² there.
    spin: the most that the body turned at (rad/s). took_s: of processor time.
    """

    error: str = ""
    held: float = math.nan
    spin: float = math.nan
    converged: bool = False
    h_error: float = math.nan
    ratio: float = math.nan
    reason: str = ""
    took_s: float = math.nan

    @property
    def right(self) -> bool:
        """Whether it is within `RIGHT_M`."""
        return self.h_error < RIGHT_M


simulated = functools.cache(simulate)


def reconstructed(task: SpaceTask) -> SpaceRow:
    """The body's log reconstructed without its truth, and scored by it."""
    run = simulated(task.kind, task.bodies, task.seconds, task.seed)[task.body]
    head, *lines = run.lines
    rig = SYSTEM.rig(head["rig"])
    events = tuple(event for line in lines for event in SYSTEM.events(line["t"], line, rig) if event is not None)
    path, readings = path_and_readings(SYSTEM.log(rig, events, ()))
    if path is None:
        raise ValueError("a simulated run has joints that report")
    begun = time.process_time()
    answer = reconstruct(path, readings, rig)
    took_s = time.process_time() - begun
    error, ratio = errors(answer, run.truth)
    spin = float(np.linalg.norm(run.truth["omega_rad_s"], axis=1).max())
    return result(
        SpaceRow, task, held=run.held, spin=spin, converged=answer.converged, h_error=error, ratio=ratio,
        reason=answer.reason, took_s=took_s,
    )  # fmt: skip


def errors(answer: BodyReconstruction, truth: dict[str, Any]) -> tuple[float, float]:
    """(RMS error of h (m), mean of (error/sd)²) within `NEAR_DEG` of the contact curves, after the best rotation."""
    if answer.coefficients is None or answer.h_sd is None:
        return math.nan, math.nan
    rows = evaluator(order_of(len(answer.coefficients)))
    directions, height = np.array(truth["directions"]), np.array(truth["h_m"])
    lasted = np.array(truth["t"]) <= answer.t[-1]
    felt = np.array(truth["normals_body"])[lasted].reshape(-1, 3)
    near = _nearest(directions, felt) >= math.cos(math.radians(NEAR_DEG))
    begun: FloatArray = np.array(truth["rotation"])[np.searchsorted(truth["t"], answer.t[0] - 1e-9)]
    coefficients, true = answer.coefficients, height[near]

    def normals(turn: FloatArray) -> FloatArray:
        return np.asarray(directions[near] @ (rotation.exp(turn) @ begun).T, np.float64)

    def off_um(turn: FloatArray) -> FloatArray:
        return np.asarray(1e6 * (rows(normals(turn))[0] @ coefficients - true), np.float64)

    # steps that are not damped may lead away where little was touched
    turn = least_squares(off_um, np.zeros(3), method="lm").x
    u, off = normals(turn), 1e-6 * off_um(turn)
    sd = answer.h_sd[(u @ answer.directions.T).argmax(axis=1)]
    return float(np.sqrt(np.mean(off**2))), float(np.mean((off / sd) ** 2))


def _nearest(directions: FloatArray, felt: FloatArray) -> FloatArray:
    """(D,) cosine of the angle from each direction to the nearest contact normal."""
    best = np.full(len(directions), -1.0)
    for part in np.array_split(felt, max(len(felt) // 500, 1)):
        best = np.maximum(best, (directions @ part.T).max(axis=1))
    return best


def draw(arguments: argparse.Namespace) -> Sequence[SpaceTask]:
    """So many bodies of each kind."""
    return [
        SpaceTask(kind, arguments.seed, arguments.runs, body, arguments.seconds)
        for kind in harness.kinds_of(arguments, tuple(KINDS))
        for body in range(arguments.runs)
    ]


OFFLINE = Study(
    "three palms",
    draw,
    reconstructed,
    SpaceRow,
    order=lambda row: (list(KINDS).index(row.kind), row.body),
    by=lambda row: row.kind,
    columns=[
        ("runs", runs),
        ("accepted", count(lambda row: row.converged)),
        ("right", count(lambda row: row.converged and row.right)),
        ("wrong", count(lambda row: row.converged and not row.right)),
        ("median µm", among(lambda row: row.converged, quantiles(lambda row: row.h_error, 1e6))),
        ("(e/sd)²", among(lambda row: row.converged, mean(lambda row: row.ratio, ".2f"))),
        ("cpu s", quantiles(lambda row: row.took_s)),
    ],
    remarks=lambda rows: [f"{row.kind} {row.body}: {row.error or row.reason}" for row in rows if not row.converged],
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(parser, runs=8, seconds_each=20.0, output="space.jsonl", kinds=tuple(KINDS))
    how = parser.add_mutually_exclusive_group().add_argument
    how("--live", action="store_true", help="in the emulated rig, by the shipped plan that swings")
    how("--exploring", action="store_true", help="in the emulated rig, by the shipped plan that explores")


def conduct(arguments: argparse.Namespace) -> int:
    """Offline or live."""
    return LIVE.conduct(arguments) if arguments.live or arguments.exploring else OFFLINE.conduct(arguments)
