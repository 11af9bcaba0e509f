"""A recorded run of a pivoting grasp: see `record.run`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from palmd import pivot_messages
from palmd.config.pivot import PivotConfig
from palmd.messages import Says
from palmd.observer.pivot.live import PivotObserver
from palmd.observer.pivot.observer import pivot_observer
from palmd.pivot_quantities import PIVOT_ANSWER
from palmd.record.run import AnyRun, RecordedAnswers
from palmd.system.pivot import SYSTEM, PivotRig


@dataclass(frozen=True, slots=True)
class PivotRun(AnyRun):
    """A recording of a pivoting grasp."""

    system: ClassVar[str] = SYSTEM
    described: ClassVar[type] = PivotRig
    says: ClassVar[Says] = pivot_messages

    config: PivotConfig
    rig: PivotRig

    def observer(self) -> PivotObserver:
        """There is one."""
        return pivot_observer(self.rig, RecordedAnswers(self._answers(PIVOT_ANSWER, pivot_messages.answer_of)))
