"""One simulated run from its scenario to the outcome: the shipped loop, core and bus on a virtual machine.

The daemon's `Loop` itself runs, with everything below it; clock, ports, sockets and helpers are virtual. The same
scenario gives identical results, checked by a digest of everything published, written, requested and answered.
"""

from __future__ import annotations

import functools
import itertools
import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

import msgpack
import yaml

from palmd import observer
from palmd.config.two_palms import Config, PlanSpec, rig_description
from palmd.daemon.bus import Bus
from palmd.daemon.commands import Request
from palmd.daemon.core import Core
from palmd.daemon.exploration_requests import Decider
from palmd.daemon.lifecycle import State
from palmd.daemon.loop import Loop
from palmd.daemon.planner import Plan
from palmd.daemon.systemd import Notifier
from palmd.events import PalmMotion
from palmd.faults import Severity
from palmd.messages import Fields, info_fields
from palmd.motion.check import motion_limits
from palmd.motion.plan import compile_plan
from palmd.observer.observer import Observer
from palmd.rig.adept_arm import AdeptArm
from palmd.rig.fault_injection import PORTS, FaultOrder
from palmd.rig.world import AWAY_S, World, default_config
from palmd.system.mechanism import PALMS
from tools.closed_loop import InlineExplorer
from tools.studies.simulation.causes import causes
from tools.studies.simulation.invariants import Breach, InvariantWatch
from tools.studies.simulation.light_rig import COARSE_STEP_S, STEP_S, LightRig
from tools.studies.simulation.machine import (
    Aside,
    CommandSocket,
    Machine,
    Publisher,
    Sockets,
    VirtualPort,
    VirtualSmoother,
    VirtualWaiter,
)
from tools.studies.simulation.scenario import (
    EXPLORE_TEXT,
    PLAN_TEXTS,
    RATE_HZ,
    Broken,
    Bytes,
    ClientRequest,
    ClockStep,
    Part,
    RandomEvent,
    Restart,
    Scenario,
    ScheduledFault,
    Slow,
    Stall,
)
from tools.studies.stub_observers import FaultyObserver, TrivialObserver

OPERATOR = 99
"""The client that restarts the motion, following the hints."""

PLANNED_S, DECIDED_S = 0.03, 0.3
_LIVELY = (
    "name: lively\nrepeat: forever\nsegments:\n- move: {phi1_deg: 42, phi2_deg: 92}\n  duration_s: 0.5\n"
    "- sine: {phi1_deg: 25, phi2_deg: 10}\n  frequency_hz: [0.41, 0.57]\n  duration_s: 20\n"
)
PLAN_OF = (PLAN_TEXTS[0], _LIVELY, PLAN_TEXTS[1], EXPLORE_TEXT)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a run: the broken invariant if any, counts of what occurred, and the digest of all messages."""

    scenario: Scenario
    breach: Breach | None
    simulated_s: float
    digest: str
    sometimes: Counter[str]


class WatchedCore(Core):
    """The shipped core, with observation of handled commands, and simulated time for its parts."""

    simulation: Simulation

    def handle(self, request: Request, t: float) -> None:
        """As the core's."""
        self.simulation.watch.handled(request, self.simulation.machine.clock.now)
        super().handle(request, t)

    def decide(self, t: float) -> None:
        """As the core's, with a simulated duration."""
        self.simulation.spend("decide")
        super().decide(t)

    def observe(self, t: float, between: Any = lambda: True) -> None:
        """As the core's, with a simulated duration."""
        self.simulation.spend("observe")
        super().observe(t, between)


class Simulation:
    """See the module."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.config = configured(scenario.autostart, scenario.rate_hz)
        self.rig: LightRig | FullRig
        if scenario.thorough:
            self.rig = FullRig(self.config, scenario.seed)
        else:
            self.rig = LightRig(self.config, scenario.seed, COARSE_STEP_S if scenario.coarse else STEP_S)
        self.machine = Machine(self.rig, scenario.latency_s)
        self._causes = tuple(causes(scenario.events))
        self.watch = InvariantWatch(self.config, self._causes, self.rig.arm, autostart=scenario.autostart)
        self._waiting = list(reversed(scenario.events))
        self._stalls: dict[Part, float] = {}
        self._slow: dict[str, tuple[float, float]] = {}
        self._broken: tuple[Any, float] | None = None
        self._numbers = itertools.count()
        self._t_look = 0.0
        self._losses = self._falls = 0
        self._breakable = FaultyObserver(TrivialObserver())
        for each in scenario.events:
            self._order(each)
        self._begin()

    # ---- the daemon --------------------------------------------------------------------------------------

    def _begin(self) -> None:
        machine, watch, clock = self.machine, self.watch, self.machine.clock
        seed = self.scenario.seed
        sound: Observer = TrivialObserver()
        if self.scenario.thorough:
            sound = observer.make("shape", rig_description(self.config), seed)
        self._breakable = FaultyObserver(sound)
        core = WatchedCore(
            self.config,
            self._breakable,
            Aside(clock, lambda: self._takes("planner", PLANNED_S)),
            _plan(self.scenario.plan),
            explorer=InlineExplorer(Decider(rig_description(self.config)), lambda: self._takes("explorer", DECIDED_S)),
            smoother=VirtualSmoother(lambda: self._takes("smoother", 0.0)),
        )
        core.simulation = self
        core.ports()
        self.core = core
        self.ports = {
            port: VirtualPort(port, machine, lambda data, t: watch.wrote(core, data, t) if data else None)
            for port in PORTS
        }
        self._commands = CommandSocket(
            lambda client, payload: watch.received(client, payload, clock.now),
            lambda client, payload: watch.answered(client, payload, clock.now),
        )
        sockets = Sockets(Publisher(self._published), self._commands)
        self.loop = Loop(
            core,
            self.ports,
            Bus("virtual", "virtual", context=cast(Any, sockets)),
            Notifier({}),
            rate_hz=self.config.loop.rate_hz,
            backend="none",
            info=_info(),
            clock=clock,
            wall=clock.wall,
            waiter=VirtualWaiter(machine, list(self.ports.values())),
        )
        self.loop.begin()

    def _published(self, frames: Sequence[bytes]) -> None:
        self.spend("publish")
        self.watch.published(frames, self.machine.clock.now)

    def spend(self, part: Part) -> None:
        """Stall the process for as long as a stall in this part lasts."""
        if part in self._stalls:
            self._pass(self._stalls.pop(part))

    def _pass(self, for_s: float) -> None:
        clock = self.machine.clock
        self.watch.happened("stall", clock.now, clock.now + for_s)
        clock.now += for_s

    def _takes(self, who: str, usually_s: float) -> float:
        takes_s, t_end = self._slow.get(who, (usually_s, -1.0))
        return takes_s if self.machine.clock.now <= t_end else usually_s

    # ---- the run -----------------------------------------------------------------------------------------

    def run(self) -> Outcome:
        """Run to the end, or to the first broken invariant."""
        clock, watch = self.machine.clock, self.watch
        while clock.now < max(watch.t_trouble, self.scenario.trouble_s) + self.scenario.calm_s and watch.breach is None:
            self.step()
        if watch.breach is None:
            self._judge_the_end(clock.now)
        return Outcome(self.scenario, watch.breach, clock.now, watch.digest.hexdigest(), watch.sometimes)

    def step(self) -> None:
        """One period of the loop."""
        clock, watch = self.machine.clock, self.watch
        self._trigger_due(clock.now)
        self._operate(clock.now)
        self.loop.period()
        self.machine.catch_up()
        if isinstance(self.rig, FullRig):
            if self.rig.contact_losses > self._losses:
                self._losses = self.rig.contact_losses
                watch.happened("left", clock.now, clock.now)
            if self.rig.falls > self._falls:
                self._falls = self.rig.falls
                self.rig.new_object()  # an observer of the rig puts the object on again
                watch.happened("left", clock.now, clock.now + AWAY_S)
        truth = self.rig.truth()
        if not _lies_on_palms(truth):
            watch.left(clock.now)
        watch.tick(self.core, self.ports, self.loop.pending_bytes, self.rig.palms(), clock.now)
        if truth:
            watch.compare(self.core, truth, clock.now)

    def _order(self, what: RandomEvent) -> None:
        """Schedule the injected faults in advance."""
        if isinstance(what, ScheduledFault):
            self.rig.fault_injector.add([FaultOrder(what.name, what.port, what.strength, what.t, what.t + what.for_s)])

    def _judge_the_end(self, t: float) -> None:
        self.watch.faults_over(self.core, t, _lies_on_palms(self.rig.truth()))
        if self.core.state not in (State.TRACKING, State.HOLD):
            self.watch.fail(t, "an operator gets the palms to move again", f"the state is {self.core.state}")

    def _trigger_due(self, t: float) -> None:
        waiting = self._waiting
        if self._broken is not None and t >= self._broken[1]:
            self._broken = None
        while waiting and waiting[-1].t <= t:
            each = waiting.pop()
            match each:
                case ClientRequest():
                    self._commands.waiting.append((each.client, each.payload))
                case Stall():
                    if each.part == "between":
                        self._pass(each.for_s)
                    else:
                        self._stalls[each.part] = each.for_s
                case Bytes():
                    self.machine.cables[each.port].spoil = functools.partial(_spoilt, each)
                case Slow():
                    self._slow[each.who] = each.takes_s, each.t + each.for_s
                case ClockStep():
                    self.machine.clock.ahead += each.by_s
                case Broken():
                    self._broken = each.how, each.t + each.for_s
                case Restart():
                    self._restart(each)
        self._breakable.how = None if self._broken is None else self._broken[0]

    def _restart(self, how: Restart) -> None:
        clock = self.machine.clock
        if not how.killed:
            self.loop.stop()
            while not self.loop.over():
                self.loop.period()
                self.watch.tick(self.core, self.ports, self.loop.pending_bytes, self.rig.palms(), clock.now)
        for port in self.ports.values():
            port.close()
        t_ended = clock.now
        self.machine.sleep(clock.now + how.after_s, lambda: False)
        self.watch.happened("restart", t_ended, clock.now)
        self.watch.restarted(clock.now)
        self._begin()

    def _operate(self, t: float) -> None:
        """Act as an operator who wants the palms to move and often reads the state."""
        if t < max(self._t_look, self.scenario.alone_s):
            return
        self._t_look = t + self.scenario.eager_s
        core = self.core
        match core.state:
            case State.READY if not core.faults.standing(Severity.STOP):
                self._command("arm")
            case State.READY | State.FAULT:
                self._command("reset")
            case State.TRACKING if not core.setpoints.moving:
                self._command("start")
            case State.HOLD if not core.faults.standing(Severity.HOLD):
                self._command("start")

    def _command(self, command: str) -> None:
        message = {"id": next(self._numbers), "cmd": command, "args": {"take": True}, "from": "operator"}
        self._commands.waiting.append((OPERATOR, msgpack.packb(message)))


class FullRig(World):
    """The whole emulated rig, with a body that rolls."""

    @property
    def arm(self) -> AdeptArm:
        """The device that turns its palms."""
        assert isinstance(self._arm, AdeptArm)
        return self._arm

    def palms(self) -> PalmMotion:
        """True angles and motion of the palms."""
        return self._palms


def simulate(scenario: Scenario) -> Outcome:
    """The outcome of a scenario."""
    with quiet():
        return Simulation(scenario).run()


def _lies_on_palms(truth: Mapping[str, Any]) -> bool:
    return all(truth.get(f"contact{palm}", True) for palm in PALMS)


def _spoilt(how: Bytes, data: bytes) -> bytes:
    match how.how:
        case "doubled":
            return data + data
        case "lost":
            return b""
    return how.stray + data


@functools.cache
def configured(autostart: bool, rate_hz: float = RATE_HZ) -> Config:
    """The shipped configuration with this tick rate, and pads that no object of these runs saturates."""
    config = default_config()
    wide = {"newtons_per_count": 0.04}
    pads = {f"palm{n}": pad.model_copy(update=wide) for n, pad in zip(PALMS, config.pads.each(), strict=True)}
    config = config.model_copy(update={"pads": config.pads.model_copy(update=pads)})
    loop = config.loop.model_copy(update={"rate_hz": rate_hz})
    return config.model_copy(update={"autostart": autostart, "loop": loop})


@functools.cache
def _plan(number: int) -> Plan:
    spec = PlanSpec.model_validate(yaml.safe_load(PLAN_OF[number]))
    limits = motion_limits(configured(False))
    return Plan(spec, compile_plan(spec, limits), limits, None)


@functools.cache
def _info() -> Fields:
    return info_fields("simulated", "shape", configured(False))


@contextmanager
def quiet() -> Any:
    """Disables logging: thousands of provoked faults need no messages."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)
