"""Choose the live observer of a pivoting grasp."""

from __future__ import annotations

from palmd.observer.pivot.live import PivotObserver
from palmd.observer.pivot.rolling import RollingObserver
from palmd.observer.smoothing import SmoothingOfOne
from palmd.system.pivot import PivotAnswer, PivotRig


def pivot_observer(rig: PivotRig, smoothing: SmoothingOfOne[PivotAnswer]) -> PivotObserver:
    """The observer for a gripper that is rigid in height, or on a slide."""
    return (RollingObserver if rig.vertical == "float" else PivotObserver)(rig, smoothing)
