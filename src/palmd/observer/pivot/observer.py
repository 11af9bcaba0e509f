"""Which live observer a pivoting grasp has."""

from __future__ import annotations

from palmd.observer.pivot.live import PivotObserver, PivotSmoothing
from palmd.observer.pivot.rolling import RollingObserver
from palmd.system.pivot import PivotRig


def pivot_observer(rig: PivotRig, smoothing: PivotSmoothing) -> PivotObserver:
    """By whether the gripper is rigid in height or on a slide."""
    return (RollingObserver if rig.vertical == "float" else PivotObserver)(rig, smoothing)
