"""A recorded run of a pivoting grasp: see `record.run`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from palmd import pivot_messages
from palmd.messages import Fields
from palmd.observer.pivot.live import PivotObserver
from palmd.observer.pivot.observer import pivot_observer
from palmd.pivot_config import PivotConfig
from palmd.pivot_quantities import PIVOT_ANSWER, PIVOT_EVENTS
from palmd.record.run import AnyRun, FedTick, RecordedAnswers
from palmd.system.pivot import SYSTEM, PivotAnswer, PivotEstimate, PivotRig


@dataclass(frozen=True, slots=True)
class PivotRun(AnyRun):
    """A recording of a pivoting grasp."""

    system: ClassVar[str] = SYSTEM
    described: ClassVar[type] = PivotRig

    config: PivotConfig
    rig: PivotRig

    def ticks(self) -> Iterator[FedTick]:
        """By `palm/pivot_events`."""
        return self._fed(PIVOT_EVENTS, pivot_messages.events_of)

    def answers(self) -> Iterator[tuple[float, PivotAnswer]]:
        """What the smoother beside the loop had to say, with the time (s) of the tick in which it was heard."""
        return self._read(PIVOT_ANSWER, lambda fields: (fields["t_tick_s"], pivot_messages.answer_of(fields)))

    def observer(self) -> PivotObserver:
        """There is one."""
        return pivot_observer(self.rig, RecordedAnswers(self.answers()))

    def said(self, estimate: PivotEstimate) -> Fields:
        """`palm/pivot`."""
        return pivot_messages.estimate_fields(estimate)
