"""An emulated touch device of the kernel's input layer: the records that it would make. Pure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from palmd.config.pads import EvdevConfig
from palmd.devices import evdev
from palmd.devices.evdev import EvdevReader, Record
from palmd.rig.pads import CountingPad, EmulatorFactory, PadOptions

REPORT_S, JITTER_S = 0.010, 0.001
PRESSURE_MAX = 255
FARTHEST = 1 << 15
TOLD_ANEW = 50
"""Every so many reports all is told, changed or not: a pseudo-terminal cannot be asked for its state, as a device can,
and what it said first may have come before whoever opened it emptied it."""


class EvdevEmulator(CountingPad):
    """Tells what has changed and nothing else; as noisy as configured, without pressure where that is configured."""

    def __init__(
        self,
        config: EvdevConfig,
        options: PadOptions,
        reading_error_m: Callable[[float, float], float],
        rng: np.random.Generator,
        t: float,
    ) -> None:
        """See `PadEmulator`."""
        self.baud = None
        self._config = config
        self._told: dict[int, int] = {}
        super().__init__(
            config, options, reading_error_m, rng, t, counts=(-FARTHEST, FARTHEST), full_scale=PRESSURE_MAX,
            shortest_s=REPORT_S - 5 * JITTER_S, noise_m=config.noise_mm * 1e-3,
        )  # fmt: skip

    def listener(self) -> EvdevReader:
        """Of its records."""
        return EvdevReader()

    def greeting(self) -> list[tuple[bytes, float]]:
        """Whoever opens it is told all anew with the next report."""
        self._told.clear()
        return []

    def overflow(self, t: float) -> bytes:
        """SYN_DROPPED; as when it is opened, all is told anew after it."""
        self._told.clear()
        return self._frame([(evdev.EV_SYN, evdev.SYN_DROPPED, 0)], t)

    def _interval(self) -> float:
        return REPORT_S + float(self._rng.normal(0.0, JITTER_S))

    def _touch(self, t: float, counts: int, across: int, pressure: int) -> bytes:
        x, y = (counts, across) if self._config.axis == "x" else (across, counts)
        axes = {evdev.ABS_X: x, evdev.ABS_Y: y}
        if self._config.pressure:
            axes[evdev.ABS_PRESSURE] = pressure
        if self.packets % TOLD_ANEW == 0:
            self._told.clear()
        changed: list[Record] = []
        if not self._told.get(evdev.BTN_TOUCH):
            self._told[evdev.BTN_TOUCH] = 1
            changed.append((evdev.EV_KEY, evdev.BTN_TOUCH, 1))
        changed += [(evdev.EV_ABS, code, value) for code, value in axes.items() if self._told.get(code) != value]
        self._told |= axes
        return self._frame(changed, t)

    def _untouched(self, t: float, lifted: bool) -> bytes:
        if not lifted:
            return b""
        self._told[evdev.BTN_TOUCH] = 0
        return self._frame([(evdev.EV_KEY, evdev.BTN_TOUCH, 0)], t)

    def _frame(self, changed: list[Record], t: float) -> bytes:
        if not changed:
            return b""
        return evdev.encode([*changed, (evdev.EV_SYN, evdev.SYN_REPORT, 0)], t)


EMULATOR: EmulatorFactory = EvdevEmulator
