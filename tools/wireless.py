"""The daemon's pure core and the emulated rig in one process: closed loop without wires, faster than real time.

The bytes of the pads and the arm go through the real codecs and arrive when a serial line would deliver them; a
client's commands go through the real parser. No clock is read: the same seed gives the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, ParamSpec, TypeVar

import msgpack

from palmd import observer
from palmd.config.pivot import PivotConfig, PivotPlanSpec, pivot_rig
from palmd.config.three_palms import ThreePalmsConfig, TiltPlanSpec, three_palms_rig
from palmd.config.two_palms import Config, PlanSpec, rig_description
from palmd.daemon.body_decider import BodyDecider
from palmd.daemon.commands import parse
from palmd.daemon.core import Core
from palmd.daemon.exploration_requests import Decider, DecisionSource, ExplorationAnswer, ExplorationDecider, Question
from palmd.daemon.lifecycle import State
from palmd.daemon.planner import Plan
from palmd.faults import Severity
from palmd.messages import Fields
from palmd.motion.check import motion_limits
from palmd.motion.pivot import PivotLimits, compile_pivot_plan
from palmd.motion.plan import compile_plan
from palmd.motion.three_palms import TiltLimits, compile_tilt_plan
from palmd.observer import Observer, ObserverName, Smoothing
from palmd.observer.pivot.incremental import PERIOD_S, SimulatedSmoothing
from palmd.observer.pivot.observer import pivot_observer
from palmd.observer.smoothing import SmoothingOfOne
from palmd.observer.three_palms.incremental import SimulatedIncrementalSmoother
from palmd.observer.three_palms.live import BodyObserver
from palmd.rig.emulated import STEP_S, EmulatedRig
from palmd.rig.pads import GOOD_PADS, PadOptions
from palmd.rig.pivot_world import PivotWorld
from palmd.rig.plant import AS_ASSUMED, FrictionSurface, PlantOptions
from palmd.rig.shapes import Body, Kind
from palmd.rig.three_palms.world import ThreePalmsWorld
from palmd.rig.world import World
from palmd.system.three_palms import BodyAnswer

ANSWER_S = 2.0
LATENCY_S = 0.3  # of a decision
READY_S = 5.0

P = ParamSpec("P")
T = TypeVar("T")
Rig = TypeVar("Rig", bound=EmulatedRig[Any])


class WirelessError(Exception):
    """The daemon refused a command or did not get ready; says what it said."""


@dataclass(frozen=True, slots=True)
class Instant:
    """One tick at `t` (s): what the daemon published, by topic, beside `rig/truth` of the same instant."""

    t: float
    messages: dict[str, Fields]
    truth: dict[str, Any]


class _ToPad(NamedTuple):
    """What a pad's driver writes to: the far end of its line."""

    world: EmulatedRig[Any]
    end: str

    def write(self, data: bytes) -> None:
        self.world.receive(self.end, data)


class ClosedLoop(Generic[Rig]):
    """One rig with one object, and one daemon; see the module. Times are seconds from 0.

    `world` and `core` may be looked at between ticks, and mischief played on the world.
    """

    def __init__(self, world: Rig, core: Core, rate_hz: float) -> None:
        """The daemon's `core` has just found its ports; it ticks at `rate_hz`."""
        self.world, self.core = world, core
        self._steps, self._steps_per_tick = 0, round(1.0 / (rate_hz * STEP_S))
        for end in core.ports():
            core.opened(end, self.t)

    @property
    def t(self) -> float:
        """The time both stand at (s)."""
        return self._steps * STEP_S

    def tick(self) -> Instant:
        """Live through one period of the loop and take stock at its end."""
        for _ in range(self._steps_per_tick):
            self._step()
        for end, pad in self.core.pads.items():
            pad.tend(_ToPad(self.world, end), self.t)
        published = self.core.step(self.t)
        return Instant(self.t, {topic.name: fields for topic, fields in published}, self.world.truth())

    def ask(self, command: str, **args: Any) -> dict[str, Any]:
        """Give a command as a client would and let time pass until it is answered; raises WirelessError."""
        self.core.handle(parse(msgpack.packb({"id": command, "cmd": command, "args": args})), self.t)
        t_end = self.t + ANSWER_S
        while self.t < t_end:
            for reply in self.core.replies():
                if reply.error is not None:
                    raise WirelessError(reply.error)
                return reply.result or {}
            self.tick()
        raise WirelessError(f"{command} was not answered within {ANSWER_S:g} s")

    def start(self) -> None:
        """Wait until the daemon is ready, arm it and start the plan; raises WirelessError."""
        while self.core.state is not State.READY:
            if self.t > READY_S:
                raise WirelessError(f"not ready within {READY_S:g} s, but {self.core.state}: {self._faults()}")
            self.tick()
        self.ask("arm")
        self.ask("start")

    def run(self, duration_s: float) -> Iterator[Instant]:
        """Go on for so many seconds, tick by tick; after a hold, start again once its cause is gone."""
        t_end = self.t + duration_s
        while self.t < t_end - STEP_S / 2:
            if self.core.state is State.HOLD and not self.core.faults.standing(Severity.HOLD):
                self.ask("start")
            yield self.tick()

    def stop(self) -> None:
        """A planned stop, until the arm is known to stand; raises WirelessError."""
        self.ask("stop")
        t_end = self.t + ANSWER_S
        while not self.core.at_rest:
            if self.t > t_end:
                raise WirelessError(f"the arm did not come to rest: {self._faults()}")
            self.tick()

    def _step(self) -> None:
        """Half a millisecond: what has arrived is read, what has fallen due is written."""
        self._steps += 1
        t = self.t
        for port, data in self.world.advance(t).items():
            if data:
                self.core.receive(port, data, t)
        if t >= self.core.due():
            self.world.receive("arm", self.core.transmit(t))

    def _faults(self) -> str:
        return ", ".join(fault.code for fault in self.core.faults.active) or "no faults"


class Wireless(ClosedLoop[World]):
    """Of two palms."""

    def __init__(
        self,
        config: Config,
        spec: PlanSpec,
        seed: int,
        *,
        kind: Kind = "rig",
        observer_name: ObserverName = "shape",
        options: PlantOptions = AS_ASSUMED,
        pad_options: PadOptions = GOOD_PADS,
        smoothing: Smoothing | None = None,
        explorer: DecisionSource | None = None,
        estimator: Observer | None = None,
        body: Body | None = None,
        surface: FrictionSurface | None = None,
    ) -> None:
        """`seed` draws the object and its friction, unless it is this `body` on this `surface`, noise, and the
        observer's samples of the prior.

        `explorer` decides explorations. Without one, a shape observer has the daemon's own, whose answers come some
        time after the questions. Without `smoothing` the observer has no smoother at its side. An `estimator` takes the
        place of the one that is named.

        Raises PlanError for a plan that cannot be run.
        """
        limits = motion_limits(config)
        plan = Plan(spec, compile_plan(spec, limits), limits, None)
        rig = rig_description(config)
        estimator = estimator or observer.make(observer_name, rig, seed, smoothing)
        if explorer is None and observer_name == "shape":
            explorer = InlineExplorer(Decider(rig, seed))
        bodies = (body,) if body else ()
        world = World(config, seed, kind=kind, options=options, pad_options=pad_options, bodies=bodies, surface=surface)
        super().__init__(world, Core(config, estimator, AtOnce(), plan, explorer=explorer), config.loop.rate_hz)


class PivotWireless(ClosedLoop[PivotWorld]):
    """Of a pivoting grasp."""

    def __init__(
        self, config: PivotConfig, spec: PivotPlanSpec, seed: int, *, kind: Kind = "rig", period_s: float = PERIOD_S
    ) -> None:
        """`seed` draws body and noise; `period_s` is how often the smoother is begun."""
        limits, rig = PivotLimits.of(config), pivot_rig(config)
        plan = Plan(spec, compile_pivot_plan(spec, limits), limits, None)
        observer = pivot_observer(rig, SimulatedSmoothing(rig, period_s))
        core = Core(config, observer, AtOnce(), plan)
        super().__init__(PivotWorld(config, seed, kind=kind), core, config.loop.rate_hz)


class ThreePalmsWireless(ClosedLoop[ThreePalmsWorld]):
    """Of three palms in space."""

    def __init__(
        self,
        config: ThreePalmsConfig,
        spec: TiltPlanSpec,
        seed: int,
        smoothing: SmoothingOfOne[BodyAnswer] | None = None,
        explorer: DecisionSource | None = None,
    ) -> None:
        """`seed` draws body and noise. `smoothing` takes the place of the smoother that knows nothing beforehand, and
        `explorer` of the one whose decisions come after a fixed time.
        """
        limits, rig = TiltLimits.of(config), three_palms_rig(config)
        plan = Plan(spec, compile_tilt_plan(spec, limits), limits, None)
        explorer = explorer or InlineExplorer(BodyDecider(rig, seed))
        core = Core(
            config, BodyObserver(rig, smoothing or SimulatedIncrementalSmoother(rig)), AtOnce(), plan, explorer=explorer
        )
        super().__init__(ThreePalmsWorld(config, seed), core, config.loop.rate_hz)


class AtOnce(Executor):
    """Does the work when it is asked for, so that nothing depends on how long it takes."""

    def submit(self, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        future: Future[T] = Future()
        try:
            future.set_result(work(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class InlineExplorer:
    """Decisions that come a fixed time after their questions: deterministic, for runs without wires.

    A question that comes while another is being answered is dropped.
    """

    def __init__(self, decider: ExplorationDecider, latency_s: float = LATENCY_S) -> None:
        self._decider = decider
        self._latency = latency_s
        self._ready: ExplorationAnswer | None = None

    def prepare(self) -> None:
        """Nothing to do."""

    def ask(self, question: Question) -> None:
        """Decide at once, and keep the answer back."""
        if self._ready is None:
            self._ready = self._decider.answer(question)

    def collect(self, t: float) -> ExplorationAnswer | None:
        """The answer to what was asked at least the latency ago."""
        ready = self._ready
        if ready is None or t < ready.t + self._latency:
            return None
        self._ready = None
        return ready
