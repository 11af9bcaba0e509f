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
from palmd.record.outline_files import OutlineCurves, curves_of
from palmd.record.run import AnyRun, RecordedAnswers
from palmd.record.surface import shadow
from palmd.system.three_palms import SYSTEM, ThreePalmsRig
from palmd.three_palms_quantities import PALM3_ANSWER

SHADOW = "x, y"


@dataclass(frozen=True, slots=True)
class ThreePalmsRun(AnyRun):
    """A recording of three palms in space."""

    system: ClassVar[str] = SYSTEM
    rig_type: ClassVar[type] = ThreePalmsRig
    codec: ClassVar[MessageCodec] = three_palms_messages

    config: ThreePalmsConfig
    rig: ThreePalmsRig

    def outline_curves(self, shape: Fields, estimate: Fields) -> OutlineCurves:
        """The body's projection onto the plane of its x and y axes, about the centre of mass, as curves for CAD."""
        halvings = int(shape["halvings"])
        h, h_sd, touched = (
            shadow(np.array(shape[name], dtype=np.float64), halvings, SHADOW) for name in ("h_m", "h_sd_m", "touched")
        )
        theta: FloatArray = np.arange(len(h), dtype=np.float64) * (math.tau / len(h))
        name = f"{self.path.stem}, object {estimate['object']}: projection of the body onto its {SHADOW} plane"
        return curves_of(name, theta, h, np.maximum(h_sd, 0.0), touched > 0.5, mass_kg=estimate["mass_kg"])

    def observer(self) -> BodyObserver:
        """The live observer of three palms."""
        return BodyObserver(
            self.rig, RecordedAnswers(self._smoother_answers(PALM3_ANSWER, three_palms_messages.answer_of))
        )
