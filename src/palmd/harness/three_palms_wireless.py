"""The daemon's core and the emulated rig of three palms in space in one process: closed loop without wires."""

from __future__ import annotations

from palmd.config.three_palms import ThreePalmsConfig, TiltPlanSpec, three_palms_rig
from palmd.daemon.body_decider import BodyDecider
from palmd.daemon.core import Core
from palmd.daemon.exploration_requests import InlineExplorer, Source
from palmd.daemon.planner import Plan
from palmd.harness.wireless import AtOnce, ClosedLoop
from palmd.motion.three_palms import TiltLimits, compile_tilt_plan
from palmd.observer.three_palms.growing import SimulatedGrowing
from palmd.observer.three_palms.live import BodyObserver, BodySmoothing
from palmd.rig.three_palms.world import ThreePalmsWorld


class ThreePalmsWireless(ClosedLoop[ThreePalmsWorld]):
    """See the module."""

    def __init__(
        self, config: ThreePalmsConfig, spec: TiltPlanSpec, seed: int, smoothing: BodySmoothing | None = None,
        explorer: Source | None = None,
    ) -> None:  # fmt: skip
        """`seed` draws body and noise. `smoothing` takes the place of the smoother that knows nothing beforehand, and
        `explorer` of the one whose decisions come after a fixed time.
        """
        limits, rig = TiltLimits.of(config), three_palms_rig(config)
        plan = Plan(spec, compile_tilt_plan(spec, limits), limits, None)
        explorer = explorer or InlineExplorer(BodyDecider(rig, seed))
        core = Core(config, BodyObserver(rig, smoothing or SimulatedGrowing(rig)), AtOnce(), plan, explorer=explorer)
        super().__init__(ThreePalmsWorld(config, seed), core, config.loop.rate_hz)
