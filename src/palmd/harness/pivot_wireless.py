"""The daemon's core and the emulated rig of a pivoting grasp in one process: closed loop, no wires, no clock read."""

from __future__ import annotations

from palmd.config.pivot import PivotConfig, PivotPlanSpec, pivot_rig
from palmd.daemon.core import Core
from palmd.daemon.planner import Plan
from palmd.harness.wireless import AtOnce, ClosedLoop
from palmd.motion.pivot import PivotLimits, compile_pivot_plan
from palmd.observer.pivot.growing import PERIOD_S, SimulatedSmoothing
from palmd.observer.pivot.observer import pivot_observer
from palmd.rig.pivot_world import PivotWorld
from palmd.rig.shapes import Kind


class PivotWireless(ClosedLoop[PivotWorld]):
    """See the module."""

    def __init__(
        self, config: PivotConfig, spec: PivotPlanSpec, seed: int, *, kind: Kind = "rig", period_s: float = PERIOD_S
    ) -> None:
        """`seed` draws body and noise; `period_s` is how often the smoother is begun."""
        limits, rig = PivotLimits.of(config), pivot_rig(config)
        plan = Plan(spec, compile_pivot_plan(spec, limits), limits, None)
        observer = pivot_observer(rig, SimulatedSmoothing(rig, period_s))
        core = Core(config, observer, AtOnce(), plan)
        super().__init__(PivotWorld(config, seed, kind=kind), core, config.loop.rate_hz)
