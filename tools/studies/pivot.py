"""The pivoting grasp reconstructed blind from simulated runs: outline about the pivot, friction, and their bands.

An outline is right if its RMS error over the touched normals is below 0.1 mm after the best rotation. Runs of the rigid
gripper (tilt) and of the slide (float) are drawn by their seeds; `--trouble` corrupts the readings. With `--live` the
daemon's core explores emulated rigs in a simulated closed loop, and what it accepts on the way is scored; a file with
live runs is resumed.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from palmd import pivot_messages as codec
from palmd.config.pivot import PivotConfig, PivotPlanSpec
from palmd.config.two_palms import DrawnImperfections
from palmd.console.arguments import between, seconds
from palmd.console.shipped import shipped
from palmd.daemon.dragging import DragExploration
from palmd.model import shape
from palmd.model.pivot import ORDER, P
from palmd.observer.outline import directions
from palmd.observer.pivot.accepted import friction_of
from palmd.pivot_quantities import PIVOT, PIVOT_ANSWER
from palmd.record.systems import read_log_of_any
from palmd.rig.imperfections import perfect
from palmd.score import WRONG_M, score_outline
from palmd.system.pivot import PivotAnswer, Vertical
from palmd.yamlfile import load_any_config, parse, read_document
from tools.closed_loop import Instant, PivotLoop
from tools.studies import harness
from tools.studies.cells import Cell, Value, among, count, most, quantiles, runs, shares
from tools.studies.cells import rms as rms_cell
from tools.studies.harness import Study, result
from tools.studies.pivot_logs import (
    AS_DESCRIBED,
    LEAST_S,
    PIVOT_KINDS,
    PivotImperfections,
    PivotKind,
    simulate_pivot_log,
)
from tools.studies.scoring import FAR, RIGHT_M, rms
from tools.studies.simulated import written

Mark = Callable[[Any], bool]


@dataclass(frozen=True)
class PivotTask:
    """One run: kind, seed, duration (s), and corruption of the readings by its name in `TROUBLES`."""

    kind: PivotKind
    seed: int
    seconds: float
    trouble: str


@dataclass(frozen=True)
class PivotRow(PivotTask):
    """The results of a task: e_m (RMS over touched normals), its 1σ, and mu_z = (estimate − truth)/1σ."""

    error: str = ""
    converged: bool = False
    reason: str = ""
    e_m: float = math.nan
    sd_m: float = math.nan
    mu_error: float = math.nan
    mu_z: float = math.nan
    touched: float = math.nan
    chi2: float = math.nan
    took_s: float = math.nan


TROUBLES: dict[str, PivotImperfections] = {
    "none": AS_DESCRIBED,
    "outliers": PivotImperfections(outliers=0.03),
    "gaps": PivotImperfections(gaps=5),
    "noise": PivotImperfections(noise=2.0, force_noise=1.5),
    "coulomb": PivotImperfections(coulomb=True),
}


def run(task: PivotTask) -> PivotRow:
    """Simulate, reconstruct and score one run."""
    lines, truth = simulate_pivot_log(task.kind, task.seed, task.seconds, TROUBLES[task.trouble])
    with written(lines) as path:
        system, log = read_log_of_any(path)
    line = system.reconstruct(log, 0).line
    row = result(
        PivotRow, task, converged=line["converged"], reason=line["reason"] or "", took_s=line["seconds"],
        chi2=math.nan if line["chi2"] is None else line["chi2"],
    )  # fmt: skip
    if not row.converged:
        return row
    theta, h, h_sd, marks = (np.array(line[name]) for name in ("theta_rad", "hP_m", "hP_sd_m", "touched"))
    score = score_outline(theta, h, marks == 1, np.array(truth["hP_m"]))
    mu_error = line["mu"] - truth["mu"]
    return replace(
        row,
        e_m=score.e_h,
        sd_m=rms(h_sd[marks == 1]),
        mu_error=mu_error,
        mu_z=mu_error / line["mu_sd"],
        touched=score.touched,
    )


def outline_columns(e: Value, sd: Value, mu_error: Value, mu_z: Value, accepted: Mark) -> Sequence[tuple[str, Cell]]:
    """Columns with errors of outline and friction of the accepted runs, absolute and relative to 1σ."""
    cells: list[tuple[str, Cell]] = [
        ("h_P, µm", quantiles(e, 1e6)),
        ("90 %", quantiles(e, 1e6, (0.9,))),
        ("error/sd", rms_cell(lambda row: e(row) / sd(row))),
        ("mu error", quantiles(lambda row: abs(mu_error(row)))),
        ("within 0.01, %", shares(lambda row: abs(mu_error(row)) < 0.01)),
        ("error/sd", rms_cell(mu_z)),
    ]
    return [(title, among(accepted, cell)) for title, cell in cells]


OFFLINE = Study(
    "pivoting grasp",
    harness.of_kinds(PIVOT_KINDS, lambda kind, seed, of: PivotTask(kind, seed, of.seconds, of.trouble)),
    run,
    PivotRow,
    order=lambda row: (row.kind, row.trouble, row.seed),
    by=lambda row: row.kind if row.trouble == "none" else f"{row.kind}, {row.trouble}",
    columns=[
        ("runs", runs),
        ("right", count(lambda row: row.converged and row.e_m < RIGHT_M)),
        ("accepted, wrong", count(lambda row: row.converged and not row.e_m < RIGHT_M)),
        *outline_columns(
            lambda row: row.e_m, lambda row: row.sd_m, lambda row: row.mu_error, lambda row: row.mu_z,
            lambda row: row.converged,
        ),
    ],
    remark=lambda row: "" if row.converged else row.reason,
)  # fmt: skip


LONGEST_S = 240.0  # longest run; explorations end by themselves before
AFTER_S = 2.0  # further time for the smoother's last answers


@dataclass(frozen=True, slots=True)
class LiveTask:
    """One exploration: seed of body, noise and rig, the rig's imperfections, and the smoother's period (s).

    vertical: whether the gripper is rigid in height or on a slide.
    """

    seed: int
    rig: DrawnImperfections
    period_s: float
    vertical: Vertical = "rigid"

    @property
    def name(self) -> str:
        """The kind of rig."""
        return self.rig if self.vertical == "rigid" else f"{self.rig}, slide"


@dataclass(frozen=True, slots=True)
class LiveRow(LiveTask):
    """The results of a task; SI units, NaN for missing values.

    accepted, reason: whether the outline is accepted at the end. t_accepted: time of the first accepted outline
    since the start; acceptances: number of accepted ones. e, most, sd: of the last accepted outline where touched:
    RMS and largest error, RMS of its 1σ. worst_e, worst_z: of all accepted outlines, the largest RMS error, and in
    1σ. mu_error, mu_z: of the last one, and in 1σ. valid: valid ticks; wrong: of these, with a contact error above
    `WRONG_M` or with a wrong outline; beyond: with a contact error above `FAR` 1σ. left: unintended losses of
    contact that were detected; losses: all losses, including intended ones at the end of a side. error: the
    exception, without any other result.
    """

    error: str = ""
    accepted: bool = False
    reason: str = ""
    ended: str = ""
    t_end: float = math.nan
    t_accepted: float = math.nan
    e: float = math.nan
    most: float = math.nan
    sd: float = math.nan
    touched: float = math.nan
    worst_e: float = math.nan
    worst_z: float = math.nan
    acceptances: int = 0
    mu_error: float = math.nan
    mu_z: float = math.nan
    ticks: int = 0
    valid: int = 0
    wrong: int = 0
    beyond: int = 0
    left: int = 0
    jams: int = 0
    losses: int = 0
    most_force: float = math.nan
    force_limit: float = math.nan
    took_s: float = math.nan

    @property
    def right(self) -> bool:
        """Whether the outline is accepted at the end and right."""
        return self.accepted and self.e < RIGHT_M

    @property
    def accepted_wrong(self) -> bool:
        """Whether some accepted outline was wrong by more than `WRONG_M` or `FAR` 1σ."""
        return self.acceptances > 0 and (self.worst_e > WRONG_M or self.worst_z > FAR)


def draw_live(arguments: argparse.Namespace) -> Sequence[LiveTask]:
    """One exploration for each seed."""
    rig: DrawnImperfections = "none" if arguments.perfect else "calibrated"
    vertical: Vertical = "float" if arguments.slide else "rigid"
    return [LiveTask(seed, rig, arguments.period, vertical) for seed in harness.seeds_of(arguments)]


def run_live(task: LiveTask) -> LiveRow:
    """Explore one body from start to end, and score all accepted estimates on the way."""
    t_cpu = time.process_time()
    config, spec = shipped_rig(task.rig, task.vertical)
    live = PivotLoop(config, spec, task.seed, period_s=task.period_s)
    scorer = LiveScorer(live)
    live.start()
    scorer.t_start, end = live.t, math.inf
    while live.t < min(LONGEST_S, end):
        scorer.take(live.tick())
        if live.core.setpoints.over:
            end = min(end, live.t + AFTER_S)
    world = live.world
    return result(
        LiveRow,
        task,
        ended=live.core.exploring.reason,
        t_end=live.t - scorer.t_start,
        left=exploring.left_the_pad if isinstance(exploring := live.core.exploring, DragExploration) else 0,
        jams=world.jams,
        losses=world.contact_losses,
        most_force=world.most_force,
        force_limit=config.limits.force_n,
        took_s=time.process_time() - t_cpu,
        **scorer.results(),
    )


def shipped_rig(rig: DrawnImperfections, vertical: Vertical) -> tuple[PivotConfig, PivotPlanSpec]:
    """The shipped configuration with these imperfections, and its exploration plan."""
    path = shipped("pivot.yaml" if vertical == "rigid" else "slide.yaml")
    config = load_any_config(path)
    plan = config.plan
    if not isinstance(config, PivotConfig) or plan is None:
        raise TypeError(f"{path} does not describe a pivoting grasp with a plan")
    config = perfect(config) if rig == "none" else config
    return config, parse(read_document(path.parent / plan), PivotPlanSpec)


@dataclass
class LiveScorer:
    """Scores the estimates of a run against the truth, tick by tick."""

    live: PivotLoop
    t_start: float = 0.0
    _results: dict[str, Any] = field(default_factory=lambda: {"worst_e": 0.0, "worst_z": 0.0, "acceptances": 0})
    _ticks: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("ticks", "valid", "wrong", "beyond"), 0))
    _outline_is_wrong: bool = False

    def take(self, tick: Instant) -> None:
        """Take one tick."""
        if (message := tick.messages.get(PIVOT_ANSWER.name)) is not None:
            self._score_answer(tick.t, codec.answer_of(message))
        estimate, truth, ticks = tick.messages[PIVOT.name], tick.truth, self._ticks
        self._results["reason"] = estimate["reason"]
        ticks["ticks"] += 1
        if not estimate["valid"]:
            return
        ticks["valid"] += 1
        error = abs(estimate["e_m"] - truth["e_m"]) if truth["touch1"] else 0.0
        ticks["wrong"] += error > WRONG_M or self._outline_is_wrong
        ticks["beyond"] += error > FAR * estimate["sd"]["e_m"]

    def _score_answer(self, t: float, answer: PivotAnswer) -> None:
        results, truth = self._results, self.live.world.object_truth()
        results["accepted"] = answer.accepted
        if not answer.accepted:
            self._outline_is_wrong = False
            return
        theta, touched = directions(), answer.touched > 0
        score = score_outline(theta, shape.basis(theta, ORDER) @ answer.p[P.SHAPE :], touched, np.array(truth["hP_m"]))
        sd = rms(answer.h_sd[touched])
        results.setdefault("t_accepted", t - self.t_start)
        results["acceptances"] += 1
        results |= {"e": score.e_h, "most": score.max_error, "sd": sd, "touched": score.touched}
        results["worst_e"] = max(results["worst_e"], score.e_h)
        results["worst_z"] = max(results["worst_z"], score.e_h / sd)
        self._outline_is_wrong = score.e_h > WRONG_M or score.e_h > FAR * sd
        mu, mu_sd = friction_of(answer.p, answer.covariance)
        results["mu_error"] = mu - truth["mu"]
        results["mu_z"] = results["mu_error"] / mu_sd

    def results(self) -> dict[str, Any]:
        """The measured fields of the row."""
        return self._results | self._ticks


def remark(row: LiveRow) -> str:
    """On a run that is not right or had a wrong accepted outline."""
    if row.right and not row.accepted_wrong:
        return ""
    if not row.acceptances:
        return row.reason or "nothing was accepted"
    error, sd = row.e * 1e6, row.sd * 1e6
    worst = f"worst errors {row.worst_e * 1e6:.0f} µm and {row.worst_z:.1f} sd"
    kept = "" if row.accepted else f", withdrawn: {row.reason}"
    return f"outline error {error:.0f} µm, sd {sd:.0f} µm, {worst}{kept}"


def _part(part: str, of: str, form: str) -> Cell:
    def cell(rows: Sequence[LiveRow]) -> str:
        some, whole = (sum(getattr(row, name) for row in rows) for name in (part, of))
        return format(some / max(whole, 1), form)

    return cell


LIVE = Study(
    "pivoting grasp, live",
    draw_live,
    run_live,
    LiveRow,
    order=lambda row: (row.name, row.seed),
    by=lambda row: row.name,
    columns=[
        ("runs", runs),
        ("right", count(lambda row: row.right)),
        ("not accepted", count(lambda row: not row.accepted)),
        ("accepted, wrong", count(lambda row: row.accepted_wrong)),
        *outline_columns(
            lambda row: row.e, lambda row: row.sd, lambda row: row.mu_error, lambda row: row.mu_z,
            lambda row: row.accepted,
        ),
        ("accepted after, s: median / 90 %", quantiles(lambda row: row.t_accepted, 1.0, (0.5, 0.9))),
        ("left the pad", count(lambda row: row.left > 0)),
        ("jams", count(lambda row: row.jams > 0)),
        ("over its limit", count(lambda row: row.most_force > row.force_limit)),
        ("most force, N", most(lambda row: row.most_force)),
        ("valid", _part("valid", "ticks", ".0%")),
        ("of those wrong", _part("wrong", "valid", ".2%")),
    ],
    title=lambda row: f"{row.name} {row.seed}",
    remark=remark,
    resumes=True,
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(
        parser, runs=100, seconds_each=12.0, output=None, kinds=PIVOT_KINDS, length=between(LEAST_S, 120.0, " s")
    )
    add = parser.add_argument
    add("--trouble", choices=tuple(TROUBLES), default="none", help="corruption of readings (default: %(default)s)")
    add("--live", action="store_true", help="explore in closed loop and score what is accepted live")
    add("--slide", action="store_true", help="live: with a gripper on a slide")
    add("--perfect", action="store_true", help="live: on exactly known rigs")
    add("--period", type=seconds, default=5.0, metavar="S",
        help="live: period of the smoother (default: %(default)s)")  # fmt: skip


def conduct(arguments: argparse.Namespace) -> int:
    """Run the offline or the live study; raises CliError as `Study.conduct` does."""
    study: Study[Any, Any] = LIVE if arguments.live else OFFLINE
    arguments.output = arguments.output or Path("pivot-live.jsonl" if arguments.live else "pivot.jsonl")
    return study.conduct(arguments)
