"""The emulated pads of three palms: square, with readings along both axes. Pure."""

from __future__ import annotations

import numpy as np

from palmd.config.three_palms import PlanePadConfig
from palmd.rig.padkinds.versapad import VersaPadEmulator
from palmd.rig.pads import PadOptions, Press


class PlanePadEmulator(VersaPadEmulator):
    """A square VersaPad with readings along both axes; `Press.across` is measured from its middle."""

    def __init__(self, config: PlanePadConfig, options: PadOptions, rng: np.random.Generator, t: float) -> None:
        """See `PadEmulator`; the pad is exactly as described."""
        super().__init__(config, options, lambda _s, _force: 0.0, rng, t)
        self._plane = config

    def _is_detected(self, press: Press) -> bool:
        side = self._plane.length_mm * 1e-3
        on_pad = 0.0 < press.s < side and abs(press.across) < 0.5 * side
        return on_pad and press.force > self._options.dead_band_n

    def _counts_across(self, across: float) -> int:
        plane = self._plane
        measured_mm = (across + float(self._rng.normal(0.0, self._noise_m))) * 1e3
        return min(max(round(plane.across_sign * measured_mm * plane.counts_per_mm), self._range[0]), self._range[1])
