"""A recorded run of a pivoting grasp: see `record.run`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from palmd import pivot_messages
from palmd.config.pivot import PivotConfig
from palmd.messages import Fields, MessageCodec
from palmd.observer.pivot.live import PivotObserver
from palmd.observer.pivot.observer import pivot_observer
from palmd.pivot_quantities import PIVOT_ANSWER
from palmd.record.outline_curves import OutlineCurves, curves_of
from palmd.record.run import AnyRun, RecordedAnswers
from palmd.system.pivot import SYSTEM, PivotRig


@dataclass(frozen=True, slots=True)
class PivotRun(AnyRun):
    """A recording of a pivoting grasp."""

    system: ClassVar[str] = SYSTEM
    described: ClassVar[type] = PivotRig
    says: ClassVar[MessageCodec] = pivot_messages

    config: PivotConfig
    rig: PivotRig

    band: ClassVar[str] = "hP_sd_m"

    def drawn(self, shape: Fields, estimate: Fields) -> OutlineCurves:
        """About the pivot."""
        names = ("theta_rad", "hP_m", "hP_sd_m", "touched")
        theta, h, h_sd, touched = (np.array(shape[name]) for name in names)
        name = f"{self.path.stem}, object {estimate['object']}, as it was known at the end"
        return curves_of(name, theta, h, h_sd, touched > 0, origin="the pivot")

    def observer(self) -> PivotObserver:
        """There is one."""
        return pivot_observer(self.rig, RecordedAnswers(self._answers(PIVOT_ANSWER, pivot_messages.answer_of)))
