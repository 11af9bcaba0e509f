"""Run the smoother of a pivoting grasp in a separate process: see `daemon.smoothing`."""

from __future__ import annotations

from palmd.daemon.smoothing import rig_from_json, work
from palmd.pivot_messages import ANSWERS
from palmd.system.pivot import PivotRig


def serve(address: str, rig: str) -> None:
    """Main function of the process, never returns; `rig`: the rig's fields as JSON."""
    from palmd.observer.pivot.incremental import IncrementalPivotSmoother  # SciPy, in this process alone

    smoother = IncrementalPivotSmoother(rig_from_json(rig, PivotRig))
    work(address, smoother.add, smoother.answer, ANSWERS.packed, lambda: smoother.period_s)
