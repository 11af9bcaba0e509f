"""The daemon's core and the emulated rig of a pivoting grasp in one process: closed loop, no wires, no clock read."""

from __future__ import annotations

from palmd.daemon.commands import Request
from palmd.daemon.core import Core
from palmd.daemon.lifecycle import State
from palmd.daemon.pivot_system import PivotGrasp
from palmd.daemon.planner import Plan
from palmd.harness.wireless import AtOnce, Instant, WirelessError
from palmd.motion.pivot import PivotLimits, compile_pivot_plan
from palmd.observer.pivot.growing import PERIOD_S, SimulatedSmoothing
from palmd.observer.pivot.live import PivotObserver
from palmd.pivot_config import PivotConfig, PivotPlanSpec, pivot_rig
from palmd.rig.emulated import STEP_S
from palmd.rig.pivot_world import PivotWorld
from palmd.rig.shapes import Kind

ANSWER_S = 3.0


class PivotWireless:
    """One rig with one body, and one daemon. Times are seconds from 0."""

    def __init__(
        self, config: PivotConfig, spec: PivotPlanSpec, seed: int, *, kind: Kind = "rig", period_s: float = PERIOD_S
    ) -> None:
        """`seed` draws body and noise; `period_s` is how often the smoother is begun."""
        limits, rig = PivotLimits.of(config), pivot_rig(config)
        plan = Plan(spec, compile_pivot_plan(spec, limits), limits, None)
        self.world = PivotWorld(config, seed, kind=kind)
        observer = PivotObserver(rig, SimulatedSmoothing(rig, period_s))
        self.core = Core(config, observer, AtOnce(), plan, system=PivotGrasp(config))
        self._steps, self._steps_per_tick = 0, round(1.0 / (config.loop.rate_hz * STEP_S))
        for end in self.core.ports():
            self.core.opened(end, self.t)

    @property
    def t(self) -> float:
        """The time both stand at (s)."""
        return self._steps * STEP_S

    def tick(self) -> Instant:
        """Live through one period of the loop and take stock at its end."""
        for _ in range(self._steps_per_tick):
            self._steps += 1
            for port, data in self.world.advance(self.t).items():
                if data:
                    self.core.receive(port, data, self.t)
            if self.t >= self.core.due():
                self.world.receive("arm", self.core.transmit(self.t))
        published = self.core.step(self.t)
        return Instant(self.t, {topic.name: fields for topic, fields in published}, self.world.truth())

    def start(self) -> None:
        """Wait until the daemon is ready, arm it and start the plan; raises WirelessError."""
        while self.core.state is not State.READY:
            if self.t > ANSWER_S:
                raise WirelessError(f"not ready: {[fault.code for fault in self.core.faults.active]}")
            self.tick()
        for command in ("arm", "start"):
            self._ask(command)

    def _ask(self, command: str) -> None:
        self.core.handle(Request(command, id=command), self.t)
        t_end = self.t + ANSWER_S
        while self.t < t_end:
            for reply in self.core.replies():
                if reply.error is not None:
                    raise WirelessError(reply.error)
                return
            self.tick()
        raise WirelessError(f"{command} was not answered")
