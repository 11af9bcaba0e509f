"""A recorded run of three palms in space: see `record.run`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from palmd import three_palms_messages
from palmd.config.three_palms import ThreePalmsConfig
from palmd.messages import Says
from palmd.observer.three_palms.live import BodyObserver
from palmd.record.run import AnyRun, RecordedAnswers
from palmd.system.three_palms import SYSTEM, ThreePalmsRig
from palmd.three_palms_quantities import PALM3_ANSWER


@dataclass(frozen=True, slots=True)
class ThreePalmsRun(AnyRun):
    """A recording of three palms in space."""

    system: ClassVar[str] = SYSTEM
    described: ClassVar[type] = ThreePalmsRig
    says: ClassVar[Says] = three_palms_messages

    config: ThreePalmsConfig
    rig: ThreePalmsRig

    def observer(self) -> BodyObserver:
        """There is one."""
        return BodyObserver(self.rig, RecordedAnswers(self._answers(PALM3_ANSWER, three_palms_messages.answer_of)))
