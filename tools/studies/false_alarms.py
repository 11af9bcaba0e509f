"""False alarms in ordinary simulated operation: how often a guard holds or stops a rig without a fault.

A simulated operator explores, runs plans, holds and starts, jogs, exchanges plans and objects; the daemon's process
gets no processor for 5 to 25 ms now and then. Exit status 1 if a guard held or stopped.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palmd.config.guards import force_limits
from palmd.config.pivot import PivotConfig, PivotPlanSpec
from palmd.config.three_palms import ThreePalmsConfig, TiltPlanSpec
from palmd.config.two_palms import Config, rig_description
from palmd.console.shipped import shipped
from palmd.daemon.lifecycle import State
from palmd.faults import Severity
from palmd.harness.operator import Operator
from palmd.observer import Simulated
from palmd.observer.pivot.incremental import PERIOD_S
from palmd.record.run import RecordedAnswers
from palmd.system.three_palms import BodyAnswer
from palmd.yamlfile import load_any_config, load_plan, parse, read_document
from tools.closed_loop import ClosedLoop, ClosedLoopError, PivotLoop, ThreePalmsLoop, TwoPalmsLoop
from tools.studies import harness
from tools.studies.cells import errors, most, runs, total
from tools.studies.harness import Goal, Study, result
from tools.studies.stub_observers import TrivialObserver

GUARDS = frozenset(
    {"following-error", "pose-implausible", "pose-contradicts-rig", "force-limit", "force-excess", "pads-mirrored"}
)
FORCES = frozenset({"force-limit", "force-excess"})
PRESSED_S = 0.3
"""Longest delay (s) of a force in a pad's running mean."""
STALL_SHARE, STALL_S = 0.02, (0.005, 0.025)
"""Share of ticks that start while the process gets no processor, and range of the stall's duration (s)."""
BETWEEN_S = (8.0, 30.0)
"""Range of time (s) between two actions of the operator."""
JOG_S, JOG_EVERY_S = 2.0, 0.05  # duration of jogging and period of its steps (s)


@dataclass(frozen=True, slots=True)
class Rig:
    """A configuration, its plans, and its joints that are jogged."""

    config: str
    plans: tuple[str, ...]
    joints: tuple[str, ...] = ()


RIGS: dict[str, Rig] = {
    "arm": Rig("demo.yaml", ("explore.yaml", "lively.yaml", "rock.yaml"), ("phi1", "phi2")),
    "servos": Rig("tabletop.yaml", ("explore.yaml", "lively.yaml", "rock.yaml"), ("phi1", "phi2")),
    "pivot": Rig("pivot.yaml", ("pivot/explore.yaml",)),
    "three_palms": Rig("three_palms.yaml", ("three_palms/explore.yaml", "three_palms/sway.yaml")),
}


@dataclass(frozen=True, slots=True)
class OperationTask:
    """One run of a rig; `seed`: of body, noise and operator. light: without a real observer."""

    rig: str
    seed: int
    seconds: float
    light: bool = False


@dataclass(frozen=True, slots=True)
class OperationRow(OperationTask):
    """The results of one run.

    moved_s: time in motion. guards: false alarms of guards (time, code, text). others: other holds and stops by code,
    including force faults while the true force exceeded the limit. commands: given commands by name. following_share:
    largest following error relative to its limit.
    """

    error: str = ""
    moved_s: float = 0.0
    guards: tuple[tuple[float, str, str], ...] = ()
    others: Mapping[str, int] = field(default_factory=dict)
    commands: Mapping[str, int] = field(default_factory=dict)
    following_share: float = math.nan


class Stalled:
    """Wraps the core of a closed loop so that it neither receives nor steps while its process is stalled."""

    def __init__(self, loop: ClosedLoop[Any], rng: np.random.Generator) -> None:
        self._loop, self._rng = loop, rng
        self._until = 0.0
        self._waiting: list[tuple[str, bytes]] = []
        core: Any = loop.core
        self._receive, self._step, self._due = core.receive, core.step, core.due
        core.receive, core.step, core.due = self.receive, self.step, self.due

    def draw(self) -> None:
        """Draw whether a stall starts; to be called once a tick."""
        if self._rng.random() < STALL_SHARE:
            self._until = self._loop.t + self._rng.uniform(*STALL_S)

    @property
    def _is_stalled(self) -> bool:
        return self._loop.t < self._until

    def receive(self, port: Any, data: bytes, t: float) -> None:
        """As the core's; delayed while stalled."""
        if self._is_stalled:
            self._waiting.append((port, data))
        else:
            self._receive(port, data, t)

    def due(self) -> float:
        """As the core's; never while stalled."""
        return math.inf if self._is_stalled else self._due()

    def step(self, t: float) -> Any:
        """As the core's; nothing is published while stalled."""
        if self._is_stalled:
            return []
        for port, data in self._waiting:
            self._receive(port, data, t)
        self._waiting.clear()
        return self._step(t)


def loop_of(rig: str, seed: int, plan: str, *, light: bool) -> ClosedLoop[Any]:
    """The closed loop of a shipped rig with a plan.

    `light`: with a trivial observer, or without a smoother.
    """
    config, path = load_any_config(shipped(RIGS[rig].config)), shipped("plans") / plan
    match config:
        case PivotConfig():
            spec = parse(read_document(path), PivotPlanSpec)
            return PivotLoop(config, spec, seed, period_s=math.inf if light else PERIOD_S)
        case ThreePalmsConfig():
            spec_in_space = parse(read_document(path), TiltPlanSpec)
            return ThreePalmsLoop(config, spec_in_space, seed, RecordedAnswers[BodyAnswer](()) if light else None)
        case Config():
            if light:
                return TwoPalmsLoop(config, load_plan(path), seed, estimator=TrivialObserver())
            return TwoPalmsLoop(config, load_plan(path), seed, smoothing=Simulated(rig_description(config)))
    raise TypeError(f"no closed loop for {rig}")


class SimulatedOperator:
    """Follows the faults' hints, and now and then gives commands as an operator does."""

    def __init__(
        self, rig: Rig, plans: tuple[str, ...], seed: int, loop: ClosedLoop[Any], limits_n: Sequence[float]
    ) -> None:
        """`limits_n`: force limits of the pads (N)."""
        self._rig, self._plans, self._loop = rig, plans, loop
        self.rng = np.random.default_rng((seed, 77))
        self._stalled = Stalled(loop, np.random.default_rng((seed, 78)))
        self._operator = Operator()
        self._t_next = self.rng.uniform(*BETWEEN_S)
        self.commands: Counter[str] = Counter()
        self.others: Counter[str] = Counter()
        self.guards: list[tuple[float, str, str]] = []
        self.moved_s = self.following_share = 0.0
        self._active: set[str] = set()
        self._limits = limits_n
        self._t_pressed = -math.inf

    def live(self, seconds: float) -> None:
        """Operate the rig for so many seconds."""
        while self._loop.t < seconds:
            self._tick()
            if command := self._operator.decide(self._loop.t):
                self._ask(command)
            if self._loop.t >= self._t_next and self._loop.core.state in (State.TRACKING, State.HOLD):
                self._t_next = self._loop.t + self.rng.uniform(*BETWEEN_S)
                self._do(str(self.rng.choice(("hold", "jog", "plan", "object"))))

    def _do(self, what: str) -> None:
        if what == "plan":
            self._ask("stop")
            self._wait(3.0, until_still=True)
            path = shipped("plans") / str(self.rng.choice(self._plans))
            self._ask("plan", path=path.name, text=path.read_text())
            self._operator = Operator()
            self._ask("arm")
        else:
            self._ask("hold")
            self._wait(self.rng.uniform(0.3, 3.0))
            if what == "jog" and self._rig.joints:
                self._jog()
            elif what == "object" and self._rig.joints:
                self._loop.world.new_object()
                self._wait(3.0)
        self._ask("start")
        self._operator.resume()

    def _jog(self) -> None:
        """Jog each joint forwards, backwards or not at all in equal steps, for `JOG_S`."""
        steps = self.rng.choice((-1, 0, 1), size=len(self._rig.joints)) * self.rng.uniform(0.1, 0.5)
        t_end = self._loop.t + JOG_S
        args = {f"{joint}_deg": float(step) for joint, step in zip(self._rig.joints, steps, strict=True)}
        while self._loop.t < t_end and self._ask("jog", **args):
            self._wait(JOG_EVERY_S)

    def _ask(self, command: str, **args: Any) -> bool:
        try:
            self._loop.ask(command, **args)
        except ClosedLoopError:
            self.commands[f"{command} refused"] += 1
            return False
        self.commands[command] += 1
        return True

    def _wait(self, seconds: float, *, until_still: bool = False) -> None:
        t_end = self._loop.t + seconds
        while self._loop.t < t_end and not (until_still and self._loop.core.at_rest):
            self._tick()

    def _tick(self) -> None:
        self._stalled.draw()
        now = self._loop.tick()
        if any(now.truth.get(f"f{pad}_n", 0.0) >= limit for pad, limit in enumerate(self._limits, 1)):
            self._t_pressed = now.t
        for topic, fields in now.messages.items():
            self._operator.take(topic, fields)
            self.following_share = max(self.following_share, *_shares(fields), 0.0)
        self.moved_s += 0.01 * self._operator.moves
        faults = {f.code: f.text for f in self._loop.core.faults.active if f.severity in (Severity.HOLD, Severity.STOP)}
        for code in faults.keys() - self._active:
            pressed = code in FORCES and now.t - self._t_pressed < PRESSED_S
            if code in GUARDS and not pressed:
                self.guards.append((round(self._loop.t, 3), code, faults[code]))
            else:
                self.others[code] += 1
        self._active = set(faults)


def _shares(fields: Mapping[str, Any]) -> Iterator[float]:
    for unit in ("rad", "m"):
        for error, limit in zip(
            fields.get(f"following_error_{unit}") or (), fields.get(f"following_limit_{unit}") or (), strict=True
        ):
            yield abs(error) / limit if limit else 0.0


def run(task: OperationTask) -> OperationRow:
    """Run one task on a shipped rig."""
    rig = RIGS[task.rig]
    plans = tuple(plan for plan in rig.plans if not task.light or task.rig == "pivot" or "explore" not in plan)
    loop = loop_of(task.rig, task.seed, plans[task.seed % len(plans)], light=task.light)
    config = load_any_config(shipped(rig.config))
    full = {f"palm{number}": pad.full_scale_n for number, pad in enumerate(config.pads.each(), 1)}
    operator = SimulatedOperator(rig, plans, task.seed, loop, force_limits(config.limits.force_n, full))
    operator.live(task.seconds)
    return result(
        OperationRow, task, moved_s=round(operator.moved_s, 1), guards=tuple(operator.guards),
        others=dict(operator.others), commands=dict(operator.commands),
        following_share=round(operator.following_share, 3),
    )  # fmt: skip


def draw(arguments: argparse.Namespace) -> Sequence[OperationTask]:
    """One run for each seed."""
    return [
        OperationTask(arguments.rig, seed, arguments.seconds, arguments.light) for seed in harness.seeds_of(arguments)
    ]


STUDY = Study(
    "false alarms",
    draw,
    run,
    OperationRow,
    order=lambda row: row.seed,
    by=lambda row: row.rig,
    columns=[
        ("runs", runs),
        ("hours", lambda rows: f"{sum(row.seconds for row in rows) / 3600.0:.2f}"),
        ("moved", lambda rows: f"{sum(row.moved_s for row in rows) / 3600.0:.2f}"),
        ("false alarms", total(lambda row: len(row.guards))),
        ("other holds and stops", total(lambda row: sum(row.others.values()))),
        ("commands", total(lambda row: sum(row.commands.values()))),
        ("largest following error / limit", most(lambda row: row.following_share)),
        ("errors", errors),
    ],
    title=lambda row: f"{row.rig} {row.seed}",
    remark=lambda row: [f"{code} after {t:g} s: {text}" for t, code, text in row.guards],
    goals=[Goal("no guard holds or stops", lambda rows: not any(row.guards or row.error for row in rows))],
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    parser.add_argument("rig", choices=RIGS)
    harness.add_arguments(parser, runs=10, seconds_each=60.0, output=None, what="how many runs")
    parser.set_defaults(seed=9100)
    parser.add_argument("--light", action="store_true", help="without a real observer, for longer simulated times")
