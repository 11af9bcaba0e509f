"""An emulated touch device of the kernel's input layer: the records that it would produce. Pure."""

from __future__ import annotations

from palmd.config.pads import EvdevConfig
from palmd.devices import evdev
from palmd.devices.evdev import EvdevReader, Record
from palmd.rig.pads import CountingPad, EmulatorFactory

PRESSURE_MAX = 255
POSITION_LIMIT = 1 << 15
FULL_REPORT_EVERY = 50
"""Every this many reports all values are sent, changed or not: unlike a device, a pseudo-terminal cannot be asked for
its state, and the host may have flushed the first report when it opened the port."""


class EvdevEmulator(CountingPad):
    """Reports only what has changed; noise as configured, without pressure if so configured."""

    _config: EvdevConfig
    _range, _full_scale = (-POSITION_LIMIT, POSITION_LIMIT), PRESSURE_MAX
    _report_s, _jitter_s = 0.010, 0.001
    baud = None

    def _begin(self, t: float) -> None:  # noqa: ARG002
        self._reported: dict[int, int] = {}

    def make_decoder(self) -> EvdevReader:
        return EvdevReader()

    def greeting(self) -> list[tuple[bytes, float]]:
        """After opening, the next report contains all values."""
        self._reported.clear()
        return []

    def overflow(self, t: float) -> bytes:
        """SYN_DROPPED; the next report then contains all values, as after opening."""
        self._reported.clear()
        return self._frame([(evdev.EV_SYN, evdev.SYN_DROPPED, 0)], t)

    def _touch_report(self, t: float, counts: int, across: int, pressure: int) -> bytes:
        x, y = (counts, across) if self._config.axis == "x" else (across, counts)
        axes = {evdev.ABS_X: x, evdev.ABS_Y: y}
        if self._config.pressure:
            axes[evdev.ABS_PRESSURE] = pressure
        if self.packets % FULL_REPORT_EVERY == 0:
            self._reported.clear()
        changed: list[Record] = []
        if not self._reported.get(evdev.BTN_TOUCH):
            self._reported[evdev.BTN_TOUCH] = 1
            changed.append((evdev.EV_KEY, evdev.BTN_TOUCH, 1))
        changed += [(evdev.EV_ABS, code, value) for code, value in axes.items() if self._reported.get(code) != value]
        self._reported |= axes
        return self._frame(changed, t)

    def _lifted_report(self, t: float, lifted: bool) -> bytes:
        if not lifted:
            return b""
        self._reported[evdev.BTN_TOUCH] = 0
        return self._frame([(evdev.EV_KEY, evdev.BTN_TOUCH, 0)], t)

    def _frame(self, changed: list[Record], t: float) -> bytes:
        if not changed:
            return b""
        return evdev.encode([*changed, (evdev.EV_SYN, evdev.SYN_REPORT, 0)], t)


EMULATOR: EmulatorFactory = EvdevEmulator
