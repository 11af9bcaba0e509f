"""The emulated rig without a body: the same controller, servos, pads, lines and mischief, some ten times as fast.

What presses on the pads is no rolling body but two contacts that move with the palms and weigh on them as statics has
it; they lift, come back and are exchanged as a body would be. Whether an estimate is right cannot be judged here.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from palmd.config import AdeptConfig, Config, VersaPadConfig
from palmd.events import PalmMotion
from palmd.rig.adept_arm import AdeptArm
from palmd.rig.fault_injection import PADS, PORTS, FaultOrder, PortName, Switchboard
from palmd.rig.imperfections import Imperfections, configured
from palmd.rig.line import Wire
from palmd.rig.pads import BAND_JITTER_S, BAND_WEIGHTS, GOOD_PADS, PadEmulator, Press, VersaPadEmulator
from palmd.system.mechanism import directions

STEP_S = 1e-3
_WEIGHT_N = 0.8
_MIDDLE_M, _SWAY_M = 0.025, 0.008
_FINGER_M = 0.045
_AWAY_S = 1.0


class _Pad(VersaPadEmulator):
    """Draws its intervals in a tenth of the time, from the same three bands."""

    def _interval(self) -> float:
        which, jitter = float(self._rng.random()), float(self._rng.normal(0.0, BAND_JITTER_S))
        band = 1 + (which >= BAND_WEIGHTS[0]) + (which >= BAND_WEIGHTS[0] + BAND_WEIGHTS[1])
        return max(self._packet_s, band * self._packet_s + jitter)


class LightRig:
    """See the module; as `World` where it is used. Times are seconds from 0."""

    def __init__(self, config: Config, seed: int) -> None:
        """At rest; raises ValueError for a rig of other parts than VersaPads and an arm."""
        if not isinstance(config.arm, AdeptConfig):
            raise ValueError("the light rig has an arm")
        self.mischief = Switchboard()
        self.lived: Callable[[float], None] | None = None  # told of every step's time (s)
        self._rng = np.random.default_rng(seed)
        self._steps = 0
        off: Imperfections = configured(config, seed)
        home = (math.radians(45.0), math.radians(90.0))
        self.arm = AdeptArm(config, config.arm, home, self._rng, step_s=STEP_S, lag_s=0.0)
        self._pads: dict[PortName, PadEmulator] = {}
        for name, pad, error in zip(PADS, config.pads.each(), off.pads, strict=True):
            assert isinstance(pad, VersaPadConfig)
            self._pads[name] = _Pad(pad, GOOD_PADS, error.reading_error_m, self._rng, 0.0)
        bauds = {name: pad.baud or 9600 for name, pad in self._pads.items()} | {"arm": config.arm.baud}
        self._out = {port: Wire(bauds[port]) for port in PORTS}
        self._t_back: float | None = -math.inf  # when the body lies on the palms again; None while a hand has it
        self._phase = float(self._rng.uniform(0.0, math.tau))

    @property
    def t(self) -> float:
        """The time it stands at (s)."""
        return self._steps * STEP_S

    def palms(self) -> PalmMotion:
        """Where the palms really are and how they move."""
        return self.arm.palms_at(self.t)

    def advance(self, t: float) -> dict[PortName, bytes]:
        """Lives on to t (s); what has come out of each port."""
        for _ in range(int((t - self.t) / STEP_S + 1e-6)):
            self._step()
        return {port: data for port in PORTS if (data := self._delivered(port, t))}

    def receive(self, port: PortName, data: bytes) -> None:
        """What the host has written; a pad listens to nothing."""
        if port == "arm":
            self.arm.receive(data, self.mischief.spoil("arm", data, self._rng), self.t)

    def opened(self, port: PortName) -> None:
        """The host has opened a port; pads without handshake have nothing to say to that."""

    def unplugged(self, port: PortName) -> bool:
        """Whether its plug has been pulled."""
        return self.mischief.strength("unplug", port) > 0.0

    def _step(self) -> None:
        self._steps += 1
        t = self.t
        for order, begins in self.mischief.update(t):
            self.arm.play(order, begins, self.palms().angles)
            self._handle_body(order, begins, t)
        for said in self.arm.step(t):
            self._say("arm", said.data, said.t)
        for name, pad in self._pads.items():
            if t >= pad.due:
                self._say(name, pad.report(t, self._presses(name, t)), t)
        if self.lived is not None:
            self.lived(t)

    def _handle_body(self, order: FaultOrder, begins: bool, t: float) -> None:
        if order.name == "lift":
            self._t_back = None if begins else t
        elif order.name == "swap" and begins:
            self._t_back = t + _AWAY_S
            self._phase = float(self._rng.uniform(0.0, math.tau))

    def _presses(self, name: PortName, t: float) -> list[Press]:
        presses = []
        if self._t_back is not None and t >= self._t_back:
            first, second = directions(self.palms().angles)
            share = math.sin(second) if name == PADS[0] else math.sin(first)
            s = _MIDDLE_M + _SWAY_M * math.sin(3.0 * (first if name == PADS[0] else second) + self._phase)
            presses.append(Press(s, _WEIGHT_N * max(share, 0.1)))
        finger = self.mischief.strength("touch", name)
        return [*presses, Press(_FINGER_M, finger)] if finger > 0.0 else presses

    def _say(self, port: PortName, data: bytes, t: float) -> None:
        if data:
            late = self.mischief.strength("late", port) - self._out[port].byte_s
            self._out[port].send(self.mischief.spoil(port, data, self._rng), t + late)

    def _delivered(self, port: PortName, t: float) -> bytes:
        return self._out[port].take(t, self.mischief.strength("burst", port))
