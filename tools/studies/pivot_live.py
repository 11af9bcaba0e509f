"""Explorations of a pivoting grasp in closed loop without wires, scored: what is claimed live, when, and how right."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from palmd import pivot_messages as says
from palmd.config.pivot import PivotConfig, PivotPlanSpec
from palmd.config.two_palms import Drawn
from palmd.console.columns import aligned
from palmd.console.shipped import shipped
from palmd.daemon.dragging import Dragging
from palmd.harness.pivot_wireless import PivotWireless
from palmd.harness.wireless import Instant
from palmd.model import shape
from palmd.model.pivot import ORDER, P
from palmd.observer.outline import directions
from palmd.observer.pivot.claimed import friction_of
from palmd.pivot_quantities import PIVOT, PIVOT_ANSWER
from palmd.rig.imperfections import perfect
from palmd.score import WRONG_M, score_outline
from palmd.system.pivot import PivotAnswer, Vertical
from palmd.yamlfile import load_any_config, parse, read_document
from tools.studies.pivot import RIGHT_M

LONGEST_S = 240.0  # of a run, whose exploration ends by itself before
AFTER_S = 2.0  # that its end is waited for what the smoother still says
BEYOND = 3.0  # one-sigmas, from which a claim is wrong


@dataclass(frozen=True, slots=True)
class LiveTask:
    """One exploration: the seed of body, noise and rig, how far off the rig is, and the smoother's period (s).

    vertical: whether the gripper is rigid in height or on a slide.
    """

    seed: int
    rig: Drawn
    period_s: float
    vertical: Vertical = "rigid"

    @property
    def name(self) -> str:
        """The kind of rig, in words."""
        return self.rig if self.vertical == "rigid" else f"{self.rig}, slide"


@dataclass(frozen=True, slots=True)
class LiveRow:
    """What came of a task; SI units, NaN for what there is not.

    claimed, reason: at the end. t_claim: of the first claim, since the start. e, most, sd: of the last outline where
    felt: RMS and largest error, RMS of its one-sigma. worst_e, worst_z: of all outlines that were claimed, the largest
    RMS error, by itself and over its one-sigma. mu_error, mu_z: of the last, and over its one-sigma. valid: ticks; of
    those wrong: by `WRONG_M` of the contact, or with an outline `BEYOND` its band; beyond: the contact's error is
    `BEYOND` its one-sigma. left: how often the body left the pad unasked, as was noticed; losses: in all, raised off at
    the end of a side too. error: what was raised, then nothing else is known.
    """

    task: LiveTask
    error: str = ""
    claimed: bool = False
    reason: str = ""
    ended: str = ""
    t_end: float = math.nan
    t_claim: float = math.nan
    e: float = math.nan
    most: float = math.nan
    sd: float = math.nan
    touched: float = math.nan
    worst_e: float = math.nan
    worst_z: float = math.nan
    claims: int = 0
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
        """The outline claimed in the end is right."""
        return self.claimed and self.e < RIGHT_M

    @property
    def wrong_claim(self) -> bool:
        """Some outline was claimed and `WRONG_M` off, or `BEYOND` its band."""
        return self.claims > 0 and (self.worst_e > WRONG_M or self.worst_z > BEYOND)


def tasks_of(
    rig: Drawn, period_s: float, vertical: Vertical, seeds: Sequence[int], done: Mapping[LiveTask, LiveRow]
) -> list[LiveTask]:
    """Those of these seeds that are not done."""
    return [task for task in (LiveTask(seed, rig, period_s, vertical) for seed in seeds) if task not in done]


def run(task: LiveTask) -> LiveRow:
    """Explore one body from start to end, and score all that is claimed on the way."""
    begun = time.process_time()
    config, spec = shipped_rig(task.rig, task.vertical)
    live = PivotWireless(config, spec, task.seed, period_s=task.period_s)
    scored = Scored(live)
    live.start()
    scored.t_start, end = live.t, math.inf
    while live.t < min(LONGEST_S, end):
        scored.take(live.tick())
        if live.core.setpoints.over:
            end = min(end, live.t + AFTER_S)
    world = live.world
    return LiveRow(
        task,
        ended=live.core.exploring.reason,
        t_end=live.t - scored.t_start,
        left=exploring.left_the_pad if isinstance(exploring := live.core.exploring, Dragging) else 0,
        jams=world.jams,
        losses=world.contact_losses,
        most_force=world.most_force,
        force_limit=config.limits.force_n,
        took_s=time.process_time() - begun,
        **scored.told(),
    )


def shipped_rig(rig: Drawn, vertical: Vertical) -> tuple[PivotConfig, PivotPlanSpec]:
    """The shipped configuration of a rig that is so far off, and the plan that explores."""
    path = shipped("pivot.yaml" if vertical == "rigid" else "slide.yaml")
    config = load_any_config(path)
    plan = config.plan
    if not isinstance(config, PivotConfig) or plan is None:
        raise TypeError(f"{path} is no pivoting grasp with a plan")
    config = perfect(config) if rig == "none" else config
    return config, parse(read_document(path.parent / plan), PivotPlanSpec)


@dataclass
class Scored:
    """Takes the ticks of a run and notes what is claimed beside what is true."""

    live: PivotWireless
    t_start: float = 0.0
    _told: dict[str, Any] = field(default_factory=lambda: {"worst_e": 0.0, "worst_z": 0.0, "claims": 0})
    _ticks: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("ticks", "valid", "wrong", "beyond"), 0))
    _outline_is_wrong: bool = False

    def take(self, tick: Instant) -> None:
        """One tick."""
        if (answered := tick.messages.get(PIVOT_ANSWER.name)) is not None:
            self._answered(tick.t, says.answer_of(answered))
        said, truth, ticks = tick.messages[PIVOT.name], tick.truth, self._ticks
        self._told["reason"] = said["reason"]
        ticks["ticks"] += 1
        if not said["valid"]:
            return
        ticks["valid"] += 1
        off = abs(said["e_m"] - truth["e_m"]) if truth["touch1"] else 0.0
        ticks["wrong"] += off > WRONG_M or self._outline_is_wrong
        ticks["beyond"] += off > BEYOND * said["sd"]["e_m"]

    def _answered(self, t: float, answer: PivotAnswer) -> None:
        told, truth = self._told, self.live.world.object_truth()
        told["claimed"] = answer.claimed
        if not answer.claimed:
            self._outline_is_wrong = False
            return
        theta, felt = directions(), answer.touched > 0
        score = score_outline(theta, shape.basis(theta, ORDER) @ answer.p[P.SHAPE :], felt, np.array(truth["hP_m"]))
        sd = float(np.sqrt(np.mean(answer.h_sd[felt] ** 2)))
        told.setdefault("t_claim", t - self.t_start)
        told["claims"] += 1
        told |= {"e": score.e_h, "most": score.max_error, "sd": sd, "touched": score.touched}
        told["worst_e"] = max(told["worst_e"], score.e_h)
        told["worst_z"] = max(told["worst_z"], score.e_h / sd)
        self._outline_is_wrong = score.e_h > WRONG_M or score.e_h > BEYOND * sd
        mu, mu_sd = friction_of(answer.p, answer.covariance)
        told["mu_error"] = mu - truth["mu"]
        told["mu_z"] = told["mu_error"] / mu_sd

    def told(self) -> dict[str, Any]:
        """For the row."""
        return self._told | self._ticks


def failed(task: LiveTask, error: BaseException) -> LiveRow:
    """The row of a run that ended in an error: a fault of ours."""
    return LiveRow(task, error=f"{type(error).__name__}: {error}")


def row_from(line: Mapping[str, Any]) -> LiveRow:
    """The row of a line; raises KeyError or TypeError for another one."""
    names = {each.name for each in fields(LiveRow)}
    told: dict[str, Any] = {name: math.nan if value is None else value for name, value in line.items()}
    if set(told) != names:
        raise KeyError(*(names ^ set(told)))
    return LiveRow(**told | {"task": LiveTask(**line["task"])})


def report(rows: Sequence[LiveRow]) -> str:
    """The study's table: a line for each kind of rig."""
    titles = [
        "runs", "right", "not claimed", "wrong claims", "h_P, µm", "90 %", "error/sd", "claimed at, s", "90 %",
        "mu off", "within 0.01", "off/sd", "left the pad", "jams", "over its limit",
        "most force, N", "valid", "of those wrong",
    ]  # fmt: skip
    rigs = sorted({row.task.name for row in rows})
    return aligned([("", titles), *((rig, _line([row for row in rows if row.task.name == rig])) for rig in rigs)])


def _line(rows: Sequence[LiveRow]) -> list[str]:
    claimed = [row for row in rows if row.claimed]
    cells = [str(len(rows)), str(sum(row.right for row in rows)), str(len(rows) - len(claimed))]
    cells.append(str(sum(row.wrong_claim for row in rows)))
    if claimed:
        e, sd, at, mu, mu_z = np.array([(r.e, r.sd, r.t_claim, r.mu_error, r.mu_z) for r in claimed]).T
        cells += [
            f"{np.median(e) * 1e6:.0f}",
            f"{np.percentile(e, 90) * 1e6:.0f}",
            f"{np.sqrt(np.mean((e / sd) ** 2)):.2f}",
            f"{np.median(at):.0f}",
            f"{np.percentile(at, 90):.0f}",
            f"{np.median(np.abs(mu)):.4f}",
            f"{np.mean(np.abs(mu) < 0.01):.0%}",
            f"{np.sqrt(np.mean(mu_z**2)):.2f}",
        ]
    else:
        cells += [""] * 8
    ticks, valid, wrong = (sum(getattr(row, name) for row in rows) for name in ("ticks", "valid", "wrong"))
    worst = max((row.most_force for row in rows if not row.error), default=math.nan)
    left, jams = str(sum(row.left > 0 for row in rows)), str(sum(row.jams > 0 for row in rows))
    over = str(sum(row.most_force > row.force_limit for row in rows))
    return [*cells, left, jams, over, f"{worst:.2f}", f"{valid / max(ticks, 1):.0%}", f"{wrong / max(valid, 1):.2%}"]


def remark(row: LiveRow) -> str:
    """What is to be said of a run that did not go as it should."""
    name = f"{row.task.name} {row.task.seed}"
    if row.error or not row.claims:
        return f"{name}: {row.error or row.reason or 'nothing was claimed'}"
    off, band = row.e * 1e6, row.sd * 1e6
    worst = f"at worst {row.worst_e * 1e6:.0f} µm and {row.worst_z:.1f} bands off"
    kept = "" if row.claimed else f", and taken back: {row.reason}"
    return f"{name}: outline {off:.0f} µm off, band {band:.0f} µm, {worst}{kept}"
