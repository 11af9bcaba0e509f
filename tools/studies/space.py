"""Unknown bodies between three palms in space reconstructed blind from simulated runs, scored against their truth.

A surface is right if its RMS error within 4 degrees of the contacts is below 0.15 mm after the best rotation. With
--live and --exploring the emulated rig runs in simulation, and the published estimates are scored tick by tick.
"""

from __future__ import annotations

import argparse
import functools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.optimize import least_squares

from palmd.blas import one_thread
from palmd.config.three_palms import ThreePalmsConfig, TiltPlanSpec
from palmd.console.shipped import shipped
from palmd.events import FloatArray
from palmd.harness.system_comparisons import matrix, surface_error
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
from tools.closed_loop import ThreePalmsLoop
from tools.studies import harness
from tools.studies.cells import among, count, mean, quantiles, runs
from tools.studies.harness import Study, result
from tools.studies.space_logs import KINDS, simulate

HALVINGS = 3  # subdivisions of the icosphere: 642 directions
GOAL = 0.8  # coverage
MARKS_S = (20.0, 40.0, 60.0)  # times at which coverage is reported
RIGHT_M = 1.5e-4
COMPARED = (
    *(f"omega_{axis}_rad_s" for axis in WORLD_AXES),
    *(f"com_{axis}_m" for axis in WORLD_AXES),
    *(f"{side}{palm}_m" for palm in PALMS for side in "ab"),
)


@dataclass(frozen=True, slots=True)
class SpaceLiveTask:
    """One body: seed, duration (s), shipped plan."""

    seed: int
    seconds: float
    plan: Literal["sway", "explore"] = "sway"


@dataclass(frozen=True, slots=True)
class SpaceLiveRow(SpaceLiveTask):
    """The live results of one body. settled, converged_after: first valid and converged (s from the first motion; NaN:
    never).

    valid: share of valid ticks since the first one. surface_error: RMS of the last accepted surface where touched (m),
    NaN without one; wrong: number of accepted surfaces with errors above `RIGHT_M`. ratio: mean (error/sd)² of spin,
    centre and contacts in valid ticks. coverage: true share of all directions within 10 degrees of a contact curve at
    each of `MARKS_S`; published: published coverage at the end. losses: number of falls off the palms; recovered:
    number of falls after which the estimate was valid again; back_s: mean time until then (s).
    """

    error: str = ""
    settled: float = math.nan
    converged_after: float = math.nan
    valid: float = math.nan
    surface_error: float = math.nan
    wrong: int = 0
    ratio: float = math.nan
    coverage: tuple[float, ...] = ()
    published: float = math.nan
    losses: int = 0
    recovered: int = 0
    back_s: float = math.nan
    reason: str = ""


class TrueCoverage:
    """The true coverage of a body."""

    def __init__(self) -> None:
        self._directions = icosphere(HALVINGS)[0]
        self._touched = np.zeros(len(self._directions), np.bool_)
        self._at_marks: list[float] = []

    def take(self, since: float, truth: dict[str, Any]) -> None:
        """Take one tick, `since` seconds after the first motion."""
        if len(self._at_marks) < len(MARKS_S) and since >= MARKS_S[len(self._at_marks)]:
            self._at_marks.append(self.share)
        if truth["touch1"]:
            still = np.zeros((1, 3))
            joints = np.array([[truth[f"{joint}_rad"] for joint in JOINTS]])
            normals = -palms_at(joints, still, still).normal[0] @ matrix(truth["quat_xyzw"])
            self._touched |= (self._directions @ normals.T).max(axis=1) > math.cos(NEAR_RAD)

    @property
    def share(self) -> float:
        """The touched share of all directions."""
        return float(self._touched.mean())

    @property
    def at_marks(self) -> tuple[float, ...]:
        """The share at each of `MARKS_S`; the last share for marks after the end."""
        return (*self._at_marks, *[self.share] * (len(MARKS_S) - len(self._at_marks)))


@one_thread()
def run_live(task: SpaceLiveTask) -> SpaceLiveRow:
    """Run the shipped configuration and plan with this seed's body and noise; the smoother has fixed latencies."""
    config = load_any_config(shipped("three_palms.yaml"))
    if not isinstance(config, ThreePalmsConfig):
        raise TypeError("three_palms.yaml does not describe three palms in space")
    spec = parse(read_document(shipped("plans") / "three_palms" / f"{task.plan}.yaml"), TiltPlanSpec)
    rig = ThreePalmsLoop(config, spec, task.seed)
    rig.start()
    t_start, settled = rig.t, math.nan
    ticks, valid, squares = 0, 0, []
    surfaces: list[tuple[float, float]] = []
    estimate: dict[str, Any] = {}
    coverage, published = TrueCoverage(), math.nan
    lost, back, losses = math.nan, list[float](), 0
    for now in rig.run(task.seconds):
        estimate, truth = now.messages[PALM3.name], now.truth
        coverage.take(rig.t - t_start, truth)
        published = now.messages.get(STATE.name, {}).get("coverage", published)
        if rig.world.contact_losses > losses:
            losses, lost = rig.world.contact_losses, rig.t
        if estimate["valid"]:
            if math.isfinite(lost):
                back.append(rig.t - lost)
                lost = math.nan
            settled = rig.t - t_start if math.isnan(settled) else settled
            valid += 1
            if math.isfinite(truth["a1_m"]):
                errors_in_sd = [(estimate[name] - truth[name]) / estimate["sd"][name] for name in COMPARED]
                squares.append(float(np.mean(np.square(errors_in_sd))))
        ticks += math.isfinite(settled)
        shape = now.messages.get(PALM3_SHAPE.name)
        if shape is not None and shape["valid"]:
            turn = matrix(truth["quat_xyzw"]).T @ matrix(estimate["quat_xyzw"])
            true = np.array(rig.world.object_truth()["h_m"])
            surfaces.append((rig.t - t_start, surface_error(shape, true, turn)[0]))
    wrong = [t for t, error in surfaces if not error < RIGHT_M]
    right = [t for t, _ in surfaces if t > max(wrong, default=-math.inf)]
    return result(
        SpaceLiveRow,
        task,
        settled=settled,
        converged_after=right[0] if right else math.nan,
        valid=valid / ticks if ticks else 0.0,
        surface_error=surfaces[-1][1] if surfaces else math.nan,
        wrong=len(wrong),
        ratio=float(np.mean(squares)) if squares else math.nan,
        coverage=coverage.at_marks,
        published=published,
        losses=losses,
        recovered=len(back),
        back_s=float(np.mean(back)) if back else math.nan,
        reason=str(estimate["reason"]),
    )


def draw_live(arguments: argparse.Namespace) -> Sequence[SpaceLiveTask]:
    """One run for each seed."""
    plan: Literal["sway", "explore"] = "explore" if arguments.exploring else "sway"
    return [SpaceLiveTask(seed, arguments.seconds, plan) for seed in harness.seeds_of(arguments)]


def remarks_on(row: SpaceLiveRow) -> list[str]:
    """One or two lines on each run."""
    lost = f", {row.recovered} times valid again after {row.back_s:.1f} s" if row.losses else ""
    lines = [
        f"valid after {row.settled:.1f} s, converged after {row.converged_after:.1f} s, valid"
        f" {row.valid:.0%} of the time since, {row.surface_error * 1e6:.0f} µm, {row.wrong} wrong,"
        f" (e/sd)² {row.ratio:.2f}, fell off {row.losses} times{lost}; {row.reason or 'valid at the end'}"
    ]
    if row.plan == "explore":
        shares = zip(MARKS_S, row.coverage, strict=True)
        touched = ", ".join(f"{share:.0%} after {mark:.0f} s" for mark, share in shares)
        lines.append(f"touched {touched}, published {row.published:.0%}")
    return lines


def _touched(row: SpaceLiveRow) -> float:
    return row.coverage[-1] if row.coverage else math.nan


LIVE = Study(
    "three palms, live",
    draw_live,
    run_live,
    SpaceLiveRow,
    order=lambda row: row.seed,
    by=lambda row: row.plan,
    columns=[
        ("bodies", runs),
        ("valid once", count(lambda row: math.isfinite(row.settled))),
        ("converged", count(lambda row: math.isfinite(row.converged_after))),
        ("after, s", quantiles(lambda row: row.converged_after)),
        ("ever wrong", count(lambda row: row.wrong > 0)),
        ("fell off", count(lambda row: row.losses > 0)),
        ("touched, %", quantiles(_touched, 100.0)),
        (f"touched {GOAL:.0%}", count(lambda row: _touched(row) >= GOAL)),
    ],
    title=lambda row: f"{row.seed:8}",
    remark=remarks_on,
)


NEAR_DEG = 4.0


@dataclass(frozen=True, slots=True)
class SpaceTask:
    """One of `bodies` that are drawn together by one seed, kind of run, duration (s)."""

    kind: str
    seed: int
    bodies: int
    body: int
    seconds: float


@dataclass(frozen=True, slots=True)
class SpaceRow(SpaceTask):
    """The results of one run.

    held: how long all palms kept contact (s). spin: largest angular rate of the body (rad/s). h_error: RMS error of h
    (m) within `NEAR_DEG` of the contact curves after the best rotation; ratio: mean of (error/sd)² there. took_s:
    processor time.
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
        """Whether its error is below `RIGHT_M`."""
        return self.h_error < RIGHT_M


simulated = functools.cache(simulate)


def run_offline(task: SpaceTask) -> SpaceRow:
    """Reconstruct the body's log blind and score it."""
    run = simulated(task.kind, task.bodies, task.seconds, task.seed)[task.body]
    head, *lines = run.lines
    rig = SYSTEM.rig(head["rig"])
    events = tuple(event for line in lines for event in SYSTEM.events(line["t"], line, rig) if event is not None)
    path, readings = path_and_readings(SYSTEM.log(rig, events, ()))
    if path is None:
        raise ValueError("the simulated log has no reports of the joints")
    t_cpu = time.process_time()
    answer = reconstruct(path, readings, rig)
    took_s = time.process_time() - t_cpu
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
    explained = np.array(truth["t"]) <= answer.t[-1]
    touched = np.array(truth["normals_body"])[explained].reshape(-1, 3)
    near = _nearest(directions, touched) >= math.cos(math.radians(NEAR_DEG))
    first: FloatArray = np.array(truth["rotation"])[np.searchsorted(truth["t"], answer.t[0] - 1e-9)]
    coefficients, true = answer.coefficients, height[near]

    def normals(turn: FloatArray) -> FloatArray:
        return np.asarray(directions[near] @ (rotation.exp(turn) @ first).T, np.float64)

    def error_um(turn: FloatArray) -> FloatArray:
        return np.asarray(1e6 * (rows(normals(turn))[0] @ coefficients - true), np.float64)

    # undamped steps may diverge if little was touched
    turn = least_squares(error_um, np.zeros(3), method="lm").x
    u, error = normals(turn), 1e-6 * error_um(turn)
    sd = answer.h_sd[(u @ answer.directions.T).argmax(axis=1)]
    return float(np.sqrt(np.mean(error**2))), float(np.mean((error / sd) ** 2))


def _nearest(directions: FloatArray, touched: FloatArray) -> FloatArray:
    """(D,) cosine of the angle from each direction to the nearest contact normal."""
    best = np.full(len(directions), -1.0)
    for part in np.array_split(touched, max(len(touched) // 500, 1)):
        best = np.maximum(best, (directions @ part.T).max(axis=1))
    return best


def draw(arguments: argparse.Namespace) -> Sequence[SpaceTask]:
    """The requested number of bodies of each kind."""
    return [
        SpaceTask(kind, arguments.seed, arguments.runs, body, arguments.seconds)
        for kind in harness.kinds_of(arguments, tuple(KINDS))
        for body in range(arguments.runs)
    ]


OFFLINE = Study(
    "three palms",
    draw,
    run_offline,
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
    title=lambda row: f"{row.kind} {row.body}",
    remark=lambda row: "" if row.converged else row.reason,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(parser, runs=8, seconds_each=20.0, output="space.jsonl", kinds=tuple(KINDS))
    how = parser.add_mutually_exclusive_group().add_argument
    how("--live", action="store_true", help="in the emulated rig, by the shipped swaying plan")
    how("--exploring", action="store_true", help="in the emulated rig, by the shipped exploration plan")


def conduct(arguments: argparse.Namespace) -> int:
    """Run the offline or the live study."""
    return LIVE.conduct(arguments) if arguments.live or arguments.exploring else OFFLINE.conduct(arguments)
