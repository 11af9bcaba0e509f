"""Processor time of the daemon's ticks on flat palms, on a cradle and in a pivoting grasp, in simulation.

All three closed loops (`config/demo.yaml`, `cradle.yaml`, `pivot.yaml`) are lived through tick by tick in turns, so
that whatever else the machine does falls on each alike; what runs beside them, smoother and explorer, is taken off.

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
from tools.wireless import InlineExplorer, PivotWireless, Wireless


class Beside:
    """How long (s) what runs beside the loop has taken: what the classes it makes do counts."""

    def __init__(self):
        self.spent = 0.0

    def counting(self, kind, name):
        """A subclass of `kind` whose method `name` counts."""

        def counted(own, *args, **kwargs):
            begun = time.thread_time()
            try:
                return getattr(super(timed, own), name)(*args, **kwargs)
            finally:
                self.spent += time.thread_time() - begun

        timed = type(kind.__name__, (kind,), {name: counted})
        return timed


def made(name, seed):
    """A closed loop on its own plan, started, and what runs beside it."""
    config, beside = load_any_config(shipped(f"{name}.yaml")), Beside()
    if config.system == "pivot":
        PivotWireless.__init__.__globals__["SimulatedSmoothing"] = beside.counting(SimulatedSmoothing, "submit")
        loop = PivotWireless(config, read_plan(config.plan, PivotLimits.of(config), None).spec, seed)
    else:
        rig = rig_description(config)
        loop = Wireless(
            config,
            read_plan(config.plan, motion_limits(config), None).spec,
            seed,
            smoothing=beside.counting(Simulated, "submit")(rig),
            explorer=InlineExplorer(beside.counting(Decider, "answer")(rig, seed)),
        )
    loop.start()
    return loop, beside, []


def main(seconds, seeds):
    taken = {name: [] for name in ("demo", "cradle", "pivot")}
    for seed in seeds:
        loops = {name: made(name, seed) for name in taken}
        freeze_collector()  # as the daemon does before its loop
        for loop, beside, ticks in loops.values():
            step = loop.core.step

            def timed(t, step=step, beside=beside, ticks=ticks):
                begun, other = time.thread_time(), beside.spent
                told = step(t)
                ticks.append(time.thread_time() - begun - (beside.spent - other))
                return told

            loop.core.step = timed
        runs = [loop.run(seconds) for loop, *_ in loops.values()]
        for _ in zip(*runs, strict=False):
            pass
        for name, (*_, ticks) in loops.items():
            taken[name] += ticks
            print(f"seed {seed}", told(name, ticks), flush=True)
    for name, ticks in taken.items():
        print("all", told(name, ticks))


def told(name, ticks):
    quantiles = np.quantile(ticks, (0.5, 0.9, 0.99)) * 1e3
    return f"{name:6} p50, p90, p99 (ms): {np.array2string(quantiles, precision=2)}"


if __name__ == "__main__":
    main(float(sys.argv[1]), [int(seed) for seed in sys.argv[2:]])
