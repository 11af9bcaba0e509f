"""Processor time of the daemon's ticks on flat palms, on a cradle and in a pivoting grasp, in simulation.

All three closed loops (`config/demo.yaml`, `cradle.yaml`, `pivot.yaml`) run tick by tick in turns, so that other load
of the machine affects all alike. The time of smoother and explorer, which run beside the loop, is subtracted.

    python tools/measure_ticks.py SECONDS SEED…
"""

import sys
import time

import numpy as np

from palmd.config.two_palms import rig_description
from palmd.console.shipped import shipped
from palmd.daemon.exploration_requests import Decider
from palmd.daemon.planner import read_plan
from palmd.daemon.realtime import freeze_collector
from palmd.motion.check import motion_limits
from palmd.motion.pivot import PivotLimits
from palmd.observer import Simulated
from palmd.observer.pivot.incremental import SimulatedSmoothing
from palmd.yamlfile import load_any_config
from tools.closed_loop import InlineExplorer, PivotLoop, TwoPalmsLoop


class HelperTime:
    """Processor time (s) of the helpers beside the loop, measured in the classes that `counting` returns."""

    def __init__(self):
        self.spent = 0.0

    def counting(self, kind, name):
        """A subclass of `kind` whose method `name` is timed."""

        def counted(own, *args, **kwargs):
            start = time.thread_time()
            try:
                return getattr(super(timed, own), name)(*args, **kwargs)
            finally:
                self.spent += time.thread_time() - start

        timed = type(kind.__name__, (kind,), {name: counted})
        return timed


def made(name, seed):
    """A started closed loop on its own plan, with its helpers' time and a list for its ticks."""
    config, helpers = load_any_config(shipped(f"{name}.yaml")), HelperTime()
    if config.system == "pivot":
        PivotLoop.__init__.__globals__["SimulatedSmoothing"] = helpers.counting(SimulatedSmoothing, "submit")
        loop = PivotLoop(config, read_plan(config.plan, PivotLimits.of(config), None).spec, seed)
    else:
        rig = rig_description(config)
        loop = TwoPalmsLoop(
            config,
            read_plan(config.plan, motion_limits(config), None).spec,
            seed,
            smoothing=helpers.counting(Simulated, "submit")(rig),
            explorer=InlineExplorer(helpers.counting(Decider, "answer")(rig, seed)),
        )
    loop.start()
    return loop, helpers, []


def main(seconds, seeds):
    taken = {name: [] for name in ("demo", "cradle", "pivot")}
    for seed in seeds:
        loops = {name: made(name, seed) for name in taken}
        freeze_collector()  # as the daemon does before its loop
        for loop, helpers, ticks in loops.values():
            step = loop.core.step

            def timed(t, step=step, helpers=helpers, ticks=ticks):
                start, other = time.thread_time(), helpers.spent
                published = step(t)
                ticks.append(time.thread_time() - start - (helpers.spent - other))
                return published

            loop.core.step = timed
        runs = [loop.run(seconds) for loop, *_ in loops.values()]
        for _ in zip(*runs, strict=False):
            pass
        for name, (*_, ticks) in loops.items():
            taken[name] += ticks
            print(f"seed {seed}", summary(name, ticks), flush=True)
    for name, ticks in taken.items():
        print("all", summary(name, ticks))


def summary(name, ticks):
    quantiles = np.quantile(ticks, (0.5, 0.9, 0.99)) * 1e3
    return f"{name:6} p50, p90, p99 (ms): {np.array2string(quantiles, precision=2)}"


if __name__ == "__main__":
    main(float(sys.argv[1]), [int(seed) for seed in sys.argv[2:]])
