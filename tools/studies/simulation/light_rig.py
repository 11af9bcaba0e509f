"""The emulated rig without a body: the same controller, servos, pads, lines and fault injection, ten times as fast.

The pads are pressed by two contacts that move with the palms and have static forces; they lift, return and are
exchanged as a body would be. Estimates cannot be judged here.
"""

from __future__ import annotations

import math

import numpy as np

from palmd.config.arms import AdeptConfig
from palmd.config.pads import VersaPadConfig
from palmd.config.two_palms import Config
from palmd.events import PalmMotion
from palmd.rig.adept_arm import AdeptArm
from palmd.rig.emulated import EmulatedRig
from palmd.rig.fault_injection import PADS, FaultOrder, PortName
from palmd.rig.imperfections import configured
from palmd.rig.padkinds.versapad import BAND_JITTER_S, BAND_WEIGHTS, VersaPadEmulator
from palmd.rig.pads import GOOD_PADS, PadEmulator, Press
from palmd.system.mechanism import directions

STEP_S, COARSE_STEP_S = 1e-3, 4e-3
"""Step of a light rig: a quarter of the controller's cycle, if times within a cycle do not matter."""
_WEIGHT_N = 0.8
_RADIUS_M, _SWAY_M = 0.022, 0.003
_NEAREST_M, _FARTHEST_M = 0.005, 0.050
_AWAY_S = 1.0


class _Pad(VersaPadEmulator):
    """Draws sampling intervals from the same three bands in a tenth of the time."""

    def _interval(self) -> float:
        which, jitter = float(self._rng.random()), float(self._rng.normal(0.0, BAND_JITTER_S))
        band = 1 + (which >= BAND_WEIGHTS[0]) + (which >= BAND_WEIGHTS[0] + BAND_WEIGHTS[1])
        return max(self._packet_s, band * self._packet_s + jitter)


class LightRig(EmulatedRig[AdeptArm]):
    """See the module. Times are seconds from 0."""

    def __init__(self, config: Config, seed: int, step_s: float = STEP_S) -> None:
        """At rest; raises ValueError for a rig with other parts than VersaPads and an arm."""
        if not isinstance(config.arm, AdeptConfig):
            raise ValueError("the light rig has an arm")
        self.seed, self.kind, self.step_s = seed, "rig", step_s
        rng, off = np.random.default_rng(seed), configured(config, seed)
        home = (math.radians(45.0), math.radians(90.0))
        self.arm = AdeptArm(config, config.arm, home, rng, step_s=step_s, lag_s=0.0)
        pads: dict[PortName, PadEmulator] = {}
        for name, pad, error in zip(PADS, config.pads.each(), off.pads, strict=True):
            assert isinstance(pad, VersaPadConfig)
            pads[name] = _Pad(pad, GOOD_PADS, error.reading_error_m, rng, 0.0)
        super().__init__(pads, self.arm, rng, 0.0)
        self._t_back: float | None = -math.inf  # when the body lies on the palms again; None while it is held
        self._phase = float(self._rng.uniform(0.0, math.tau))

    def palms(self) -> PalmMotion:
        """True angles and motion of the palms."""
        return self.arm.palms_at(self.t)

    def _step(self) -> None:
        self._steps += 1
        t = self.t
        self._inject_due_faults(t)
        self._transmit_due(t)

    def _inject_fault(self, order: FaultOrder, begins: bool) -> None:
        self.arm.inject_fault(order, begins, self.palms().angles)
        if order.name == "lift":
            self._t_back = None if begins else self.t
        elif order.name == "swap" and begins:
            self._t_back = self.t + _AWAY_S
            self._phase = float(self._rng.uniform(0.0, math.tau))

    def _object_presses(self, pad: PortName) -> list[Press]:
        if self._t_back is None or self.t < self._t_back:
            return []
        first, second = directions(self.palms().angles)
        share = math.sin(second) if pad == PADS[0] else math.sin(first)
        round_body = _RADIUS_M / math.tan(0.5 * (second - first))
        s = round_body + _SWAY_M * math.sin(3.0 * (first if pad == PADS[0] else second) + self._phase)
        return [Press(min(max(s, _NEAREST_M), _FARTHEST_M), _WEIGHT_N * max(share, 0.1))]
