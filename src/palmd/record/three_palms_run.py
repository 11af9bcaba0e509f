"""A recorded run of three palms in space: see `record.run`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from palmd import three_palms_messages
from palmd.config.three_palms import ThreePalmsConfig
from palmd.events import FloatArray
from palmd.messages import Fields, MessageCodec
from palmd.observer.three_palms.live import BodyObserver
from palmd.record.outline_curves import OutlineCurves, curves_of
from palmd.record.run import AnyRun, RecordedAnswers
from palmd.record.surface import shadow
from palmd.system.three_palms import SYSTEM, ThreePalmsRig
from palmd.three_palms_quantities import PALM3_ANSWER

SHADOW = "x, y"


@dataclass(frozen=True, slots=True)
class ThreePalmsRun(AnyRun):
    """A recording of three palms in space."""

    system: ClassVar[str] = SYSTEM
    described: ClassVar[type] = ThreePalmsRig
    says: ClassVar[MessageCodec] = three_palms_messages

    config: ThreePalmsConfig
    rig: ThreePalmsRig

    def drawn(self, shape: Fields, estimate: Fields) -> OutlineCurves:
        """Its shadow on the plane of the body's x and y, about the centre of mass."""
        halvings = int(shape["halvings"])
        h, h_sd, touched = (
            shadow(np.array(shape[name], dtype=np.float64), halvings, SHADOW) for name in ("h_m", "h_sd_m", "touched")
        )
        theta: FloatArray = np.arange(len(h), dtype=np.float64) * (math.tau / len(h))
        name = f"{self.path.stem}, object {estimate['object']}: shadow of the body on the plane of its {SHADOW}"
        return curves_of(name, theta, h, np.maximum(h_sd, 0.0), touched > 0.5, mass_kg=estimate["mass_kg"])

    def observer(self) -> BodyObserver:
        """There is one."""
        return BodyObserver(self.rig, RecordedAnswers(self._answers(PALM3_ANSWER, three_palms_messages.answer_of)))
