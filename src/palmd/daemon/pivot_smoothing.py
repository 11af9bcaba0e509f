"""The process of a pivoting grasp's smoother: see `daemon.smoothing`."""

from __future__ import annotations

from palmd.daemon.smoothing import flat, rig_from_json, work
from palmd.system.pivot import PivotRig


def serve(address: str, rig: str) -> None:
    """Main function of the process, never returns; `rig`: the rig's fields as JSON."""
    from palmd.observer.pivot.incremental import PERIOD_S, IncrementalPivotSmoother  # SciPy, in this process alone

    smoother = IncrementalPivotSmoother(rig_from_json(rig, PivotRig))
    work(address, smoother.add, lambda: flat(smoother.answer()), lambda: PERIOD_S)
