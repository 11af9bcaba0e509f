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
from palmd.record.outline_files import OutlineCurves, curves_of
from palmd.record.run import AnyRun, RecordedAnswers
from palmd.system.pivot import SYSTEM, PivotRig


@dataclass(frozen=True, slots=True)
class PivotRun(AnyRun):
    """A recording of a pivoting grasp."""

    system: ClassVar[str] = SYSTEM
    rig_type: ClassVar[type] = PivotRig
    codec: ClassVar[MessageCodec] = pivot_messages

    config: PivotConfig
    rig: PivotRig

    sd_field: ClassVar[str] = "hP_sd_m"

    def outline_curves(self, shape: Fields, estimate: Fields) -> OutlineCurves:
        """The outline about the pivot as curves for CAD."""
        names = ("theta_rad", "hP_m", "hP_sd_m", "touched")
        theta, h, h_sd, touched = (np.array(shape[name]) for name in names)
        name = f"{self.path.stem}, object {estimate['object']}, last valid estimate"
        return curves_of(name, theta, h, h_sd, touched > 0, origin="the pivot")

    def observer(self) -> PivotObserver:
        """The live observer of a pivoting grasp."""
        return pivot_observer(self.rig, RecordedAnswers(self._smoother_answers(PIVOT_ANSWER, pivot_messages.answer_of)))
