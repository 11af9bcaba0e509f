"""A pad's driver and its emulated device on one line without wires, in steps of 0.5 ms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from palmd.config.pads import EvdevConfig, PadConfig, StripConfig, TaxelsConfig, VersaPadConfig
from palmd.devices.pad import make_pad
from palmd.events import PadLift, PadSample
from palmd.rig.line import Wire
from palmd.rig.pads import PadOptions, Press, make_emulator

STEP_S, TICK_STEPS = 5e-4, 20
EXACT = PadOptions(noise_m=1e-5, force_noise=0.0, force_drift=0.0, hysteresis=0.0)
ARRAY = {"kind": "taxels", "port": "a", "columns": 4, "zero_mm": 1.0, "noise_mm": 0.01, "taxel_gain_sd": 0.0}
KINDS: dict[str, PadConfig] = {
    "versapad": VersaPadConfig(port="a"),
    "strip": StripConfig(kind="strip", port="a", noise_mm=0.01),
    "evdev": EvdevConfig(kind="evdev", port="a", noise_mm=0.01),
    "tsf85": TaxelsConfig(protocol="tsf85", rows=14, pitch_mm=4.5, **ARRAY),
    "st0001": TaxelsConfig(protocol="st0001", rows=15, pitch_mm=4.0, **ARRAY),
    "text": TaxelsConfig(protocol="text", rows=20, pitch_mm=3.0, baud=1_000_000, **ARRAY),
}


class PadBench:
    """`spoil` may alter the bytes to the host. `press` presses the pad, None for nothing; `events` collects the
    results.

    plugged: whether bytes pass. said: all bytes the device has sent.
    """

    def __init__(self, config: PadConfig, spoil: Callable[[bytes], bytes] = bytes, seed: int = 1) -> None:
        self.config, self.t, self.press, self.plugged = config, 0.0, None, True
        self.driver = make_pad(1, config)
        self.events: list[tuple[float, PadSample | PadLift]] = []
        self.said = bytearray()
        self._spoil, self._seed = spoil, seed
        self._step = 0
        self.restart()
        self.driver.opened(0.0)

    def restart(self) -> None:
        """Restarts the device, which forgets its settings."""
        self._far = make_emulator(self.config, EXACT, lambda _s, _force: 0.0, np.random.default_rng(self._seed), self.t)
        self._out = Wire(self._far.baud or 10_000_000)

    def write(self, data: bytes) -> None:
        """Bytes from the driver to the device."""
        if self.plugged:
            self._far.receive(data, self.t)

    def go(self, seconds: float) -> PadBench:
        """Runs for so long (s)."""
        for _ in range(round(seconds / STEP_S)):
            self._step += 1
            self.t = self._step * STEP_S
            if self.t >= self._far.due:
                said = self._far.report(self.t, [] if self.press is None else [self.press])
                self.said += said
                self._out.send(self._spoil(said), self.t)
            data = self._out.take(self.t)
            if data and self.plugged:
                self._take(self.driver.feed(data, self.t))
            if self._step % TICK_STEPS == 0 and self.driver.is_open:
                self._take(self.driver.poll(self.t))
                self.driver.tend(self, self.t)
        return self

    def touched(self, s: float, seconds: float = 0.3, force: float = 1.0) -> PadBench:
        """Presses at s (m) for so long."""
        self.press = Press(s, force)
        return self.go(seconds)

    def samples(self, since: float = 0.0) -> list[PadSample]:
        """Contact readings after a time (s)."""
        return [event for t, event in self.events if t > since and isinstance(event, PadSample)]

    def lifts(self, since: float = 0.0) -> list[float]:
        """Times of the lift-offs (s)."""
        return [t for t, event in self.events if t > since and isinstance(event, PadLift)]

    def _take(self, events) -> None:
        self.events += [(self.t, event) for event in events]
