"""A recorded run of three palms in space: see `record.run`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from palmd import three_palms_messages
from palmd.messages import Fields
from palmd.observer.three_palms.live import BodyObserver
from palmd.quantities import PALM3_ANSWER, PALM3_EVENTS
from palmd.record.run import AnyRun, FedTick, RecordedAnswers
from palmd.system.three_palms import SYSTEM, BodyAnswer, BodyEstimate, ThreePalmsRig
from palmd.three_palms_config import ThreePalmsConfig


@dataclass(frozen=True, slots=True)
class ThreePalmsRun(AnyRun):
    """A recording of three palms in space."""

    system: ClassVar[str] = SYSTEM
    described: ClassVar[type] = ThreePalmsRig

    config: ThreePalmsConfig
    rig: ThreePalmsRig

    def ticks(self) -> Iterator[FedTick]:
        """By `palm3/events`."""
        return self._fed(PALM3_EVENTS, three_palms_messages.events_of)

    def answers(self) -> Iterator[tuple[float, BodyAnswer]]:
        """What the smoother beside the loop had to say, with the time (s) of the tick in which it was heard."""
        return self._read(PALM3_ANSWER, lambda fields: (fields["t_tick_s"], three_palms_messages.answer_of(fields)))

    def observer(self) -> BodyObserver:
        """There is one."""
        return BodyObserver(self.rig, RecordedAnswers(self.answers()))

    def said(self, estimate: BodyEstimate) -> Fields:
        """`palm3/estimate`."""
        return three_palms_messages.estimate_fields(estimate)
