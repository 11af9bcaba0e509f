"""Simulated closed loop: the daemon's pure core and the emulated rig in one process, faster than real time.

The bytes of the pads and the arm go through the real codecs and arrive when a serial line would deliver them; a
client's commands go through the real parser. No clock is read: the same seed gives identical results.
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

ANSWER_S = 2.0  # longest time to an answer
LATENCY_S = 0.3  # of a decision of the explorer
READY_S = 5.0  # longest time until the daemon is ready

P = ParamSpec("P")
T = TypeVar("T")
Rig = TypeVar("Rig", bound=EmulatedRig[Any])


class ClosedLoopError(Exception):
    """The daemon refused a command or did not become ready; with its message."""


@dataclass(frozen=True, slots=True)
class Instant:
    """One tick at `t` (s): the daemon's messages by topic, and `rig/truth` at the same time."""

    t: float
    messages: dict[str, Fields]
    truth: dict[str, Any]


class _ToPad(NamedTuple):
    """The far end of a pad's line, to which its driver writes."""

    world: EmulatedRig[Any]
    end: str

    def write(self, data: bytes) -> None:
        self.world.receive(self.end, data)


class ClosedLoop(Generic[Rig]):
    """One rig with one object, and one daemon; see the module. Times are seconds from 0.

    `world` and `core` may be inspected between ticks, and faults injected into the world.
    """

    def __init__(self, world: Rig, core: Core, rate_hz: float) -> None:
        """Connect the daemon's `core`, which ticks at `rate_hz`, to the rig's ports."""
        self.world, self.core = world, core
        self._steps, self._steps_per_tick = 0, round(1.0 / (rate_hz * STEP_S))
        for end in core.ports():
            core.opened(end, self.t)

    @property
    def t(self) -> float:
        """The present time of rig and daemon (s)."""
        return self._steps * STEP_S

    def tick(self) -> Instant:
        """Simulate one period of the daemon's loop; returns the messages at its end."""
        for _ in range(self._steps_per_tick):
            self._step()
        for end, pad in self.core.pads.items():
            pad.tend(_ToPad(self.world, end), self.t)
        published = self.core.step(self.t)
        return Instant(self.t, {topic.name: fields for topic, fields in published}, self.world.truth())

    def ask(self, command: str, **args: Any) -> dict[str, Any]:
        """Send a command as a client and simulate until its result arrives; raises ClosedLoopError if it is refused."""
        self.core.handle(parse(msgpack.packb({"id": command, "cmd": command, "args": args})), self.t)
        t_end = self.t + ANSWER_S
        while self.t < t_end:
            for reply in self.core.replies():
                if reply.error is not None:
                    raise ClosedLoopError(reply.error)
                return reply.result or {}
            self.tick()
        raise ClosedLoopError(f"{command} was not answered within {ANSWER_S:g} s")

    def start(self) -> None:
        """Simulate until the daemon is ready, arm it and start the plan; raises ClosedLoopError."""
        while self.core.state is not State.READY:
            if self.t > READY_S:
                raise ClosedLoopError(f"not ready within {READY_S:g} s, but {self.core.state}: {self._faults()}")
            self.tick()
        self.ask("arm")
        self.ask("start")

    def run(self, duration_s: float) -> Iterator[Instant]:
        """Simulate so many seconds, tick by tick; after a hold, start again once its cause has cleared."""
        t_end = self.t + duration_s
        while self.t < t_end - STEP_S / 2:
            if self.core.state is State.HOLD and not self.core.faults.standing(Severity.HOLD):
                self.ask("start")
            yield self.tick()

    def stop(self) -> None:
        """Stop as planned and simulate until the arm is known to be at rest; raises ClosedLoopError."""
        self.ask("stop")
        t_end = self.t + ANSWER_S
        while not self.core.at_rest:
            if self.t > t_end:
                raise ClosedLoopError(f"the arm did not come to rest: {self._faults()}")
            self.tick()

    def _step(self) -> None:
        """Simulate half a millisecond: deliver arrived bytes, and write what is due."""
        self._steps += 1
        t = self.t
        for port, data in self.world.advance(t).items():
            if data:
                self.core.receive(port, data, t)
        if t >= self.core.due():
            self.world.receive("arm", self.core.transmit(t))

    def _faults(self) -> str:
        return ", ".join(fault.code for fault in self.core.faults.active) or "no faults"


class TwoPalmsLoop(ClosedLoop[World]):
    """The closed loop of two palms."""

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
        """`seed`: of the object and its friction, unless `body` and `surface` are given, of noise, and of the
        observer's samples of the prior.

        `explorer` decides explorations; by default a shape observer has the daemon's explorer, with a fixed latency.
        Without `smoothing` the observer has no smoother. `estimator` replaces the observer named by `observer_name`.
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


class PivotLoop(ClosedLoop[PivotWorld]):
    """The closed loop of a pivoting grasp."""

    def __init__(
        self, config: PivotConfig, spec: PivotPlanSpec, seed: int, *, kind: Kind = "rig", period_s: float = PERIOD_S
    ) -> None:
        """`seed`: of body and noise; `period_s`: period of the smoother."""
        limits, rig = PivotLimits.of(config), pivot_rig(config)
        plan = Plan(spec, compile_pivot_plan(spec, limits), limits, None)
        observer = pivot_observer(rig, SimulatedSmoothing(rig, period_s))
        core = Core(config, observer, AtOnce(), plan)
        super().__init__(PivotWorld(config, seed, kind=kind), core, config.loop.rate_hz)


class ThreePalmsLoop(ClosedLoop[ThreePalmsWorld]):
    """The closed loop of three palms in space."""

    def __init__(
        self,
        config: ThreePalmsConfig,
        spec: TiltPlanSpec,
        seed: int,
        smoothing: SmoothingOfOne[BodyAnswer] | None = None,
        explorer: DecisionSource | None = None,
    ) -> None:
        """`seed`: of body and noise. `smoothing` replaces the default smoother without prior knowledge, and `explorer`
        the default one with a fixed latency.
        """
        limits, rig = TiltLimits.of(config), three_palms_rig(config)
        plan = Plan(spec, compile_tilt_plan(spec, limits), limits, None)
        explorer = explorer or InlineExplorer(BodyDecider(rig, seed))
        core = Core(
            config, BodyObserver(rig, smoothing or SimulatedIncrementalSmoother(rig)), AtOnce(), plan, explorer=explorer
        )
        super().__init__(ThreePalmsWorld(config, seed), core, config.loop.rate_hz)


class AtOnce(Executor):
    """An executor that does the work within `submit`, so that nothing depends on its duration."""

    def new_future(self) -> Future[Any]:
        """A future for work that is submitted now."""
        return Future()

    def submit(self, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        future = self.new_future()
        try:
            future.set_result(work(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class InlineExplorer:
    """An explorer whose decisions have a defined latency, for deterministic simulations.

    A question is dropped while another one is pending.
    """

    def __init__(self, decider: ExplorationDecider, latency_s: float | Callable[[], float] = LATENCY_S) -> None:
        """`latency_s`: of each decision, or a function that returns that of a decision requested now (s)."""
        self._decider = decider
        self._latency_s = latency_s
        self._ready: tuple[float, ExplorationAnswer] | None = None

    def prepare(self) -> None:
        """Nothing to do."""

    def ask(self, question: Question) -> None:
        """Decide at once; the answer is returned after the latency."""
        if self._ready is None:
            latency_s = self._latency_s() if callable(self._latency_s) else self._latency_s
            self._ready = question.t + latency_s, self._decider.answer(question)

    def collect(self, t: float) -> ExplorationAnswer | None:
        """The answer to a question that is at least as old as the latency."""
        if self._ready is None or t < self._ready[0]:
            return None
        (_, answer), self._ready = self._ready, None
        return answer
