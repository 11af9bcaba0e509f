"""The touch test: a finger tells which pad is which, which axis lies along the palm, and which way it runs."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from palmd.config.pads import PadConfig
from palmd.config.two_palms import PadsConfig
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.devices.pad import PadReport, make_pad
from palmd.devices.port import PortWaiter
from palmd.system.mechanism import HELD_BY, PALMS

TOUCH_WITHIN_S = 20.0
LIFTED_S = 0.5
"""A silence of this length ends a stroke."""

FEWEST_REPORTS = 12
STRAIGHT = 2.0
"""By how much a stroke must be longer along one axis than along the other."""

_LOOK_S = 0.02


@dataclass(frozen=True, slots=True)
class FingerStroke:
    """A finger that slid over a pad from the hinge outwards: the reports' counts, in order."""

    heard_on: int  # by the configuration
    x: tuple[int, ...]
    y: tuple[int, ...]

    def slid(self) -> tuple[int, int]:
        """How far along x and along y (counts), from the mean of the first fifth to that of the last."""
        fifth = max(1, len(self.x) // 5)
        along_x, along_y = (sum(c[-fifth:]) - sum(c[:fifth]) for c in (self.x, self.y))
        return round(along_x / fifth), round(along_y / fifth)


class _Listener:
    """One pad's port, and what has come from it."""

    def __init__(self, palm: int, pad: PadConfig) -> None:
        """Opens it; CliError when it cannot be opened."""
        t = time.monotonic()
        self.palm = palm
        self._pad = make_pad(palm, pad)
        self.port = self._pad.port()
        if not self.port.poll_open(t):
            raise CliError(RIG_FAILED, str(self.port.error))
        self._pad.opened(t)

    def hear(self) -> list[PadReport]:
        """The reports of a touch that have come; CliError when the port is lost."""
        data = self.port.read()
        t = time.monotonic()
        if not self.port.is_open:
            raise CliError(RIG_FAILED, str(self.port.error))
        reports = self._pad.reports(data, t)
        self._pad.tend(self.port, t)
        return [report for report in reports if report.in_use]


def examine_pads(path: Path, pads: PadsConfig) -> int:
    """Asks for a stroke on each pad and prints what to change; 0 if there is nothing, else 1.

    CliError when a port cannot be opened, or nobody touches a pad.
    """
    listeners: list[_Listener] = []
    strokes: list[FingerStroke] = []
    try:
        for palm in PALMS:
            listeners.append(_Listener(palm, pads.of(palm)))
        for palm, held in zip(PALMS, HELD_BY, strict=True):
            which = f"palm {palm}, the one {held}"
            print(
                f"{which}: put a finger on its pad near the hinge between the palms, slide outwards, lift",
                flush=True,
            )
            strokes.append(_stroke(palm, listeners))
    finally:
        for listener in listeners:
            listener.port.close()
    lines = list(changes(strokes, pads))
    if not lines:
        print(f"both pads are as {path} says")
        return 0
    print(f"write in {path}:")
    print("\n".join(lines))
    return BAD_INPUT


def _stroke(palm: int, listeners: Sequence[_Listener]) -> FingerStroke:
    """The next one, on whichever pad it comes; on both at once is a mistake."""
    waiter = PortWaiter([listener.port for listener in listeners])
    heard: dict[int, list[PadReport]] = {listener.palm: [] for listener in listeners}
    t = time.monotonic()
    t_end = t + TOUCH_WITHIN_S
    while t < t_end:
        waiter.wait(min(t + _LOOK_S, t_end))
        for listener in listeners:
            packets = listener.hear()
            heard[listener.palm] += packets
            if packets:
                t_end = time.monotonic() + LIFTED_S
        t = time.monotonic()
    touched = [each for each, packets in heard.items() if len(packets) >= FEWEST_REPORTS]
    if len(touched) != 1:
        what = "both pads were touched at once" if touched else f"no stroke within {TOUCH_WITHIN_S:.0f} s"
        raise CliError(RIG_FAILED, f"palm {palm}: {what}; start again with palmd doctor --touch")
    packets = heard[touched[0]]
    print(f"  heard on the port of pads.palm{touched[0]}, {len(packets)} reports", flush=True)
    return FingerStroke(
        touched[0], tuple(packet.x_counts for packet in packets), tuple(packet.y_counts for packet in packets)
    )


def changes(strokes: Sequence[FingerStroke], pads: PadsConfig) -> Iterator[str]:
    """What to write into the configuration, given a stroke on palm 1 and then one on palm 2. Pure.

    CliError where the strokes do not tell: both on one pad, or neither along x nor along y.
    """
    if len({stroke.heard_on for stroke in strokes}) < len(strokes):
        raise CliError(RIG_FAILED, f"both strokes were heard on pads.palm{strokes[0].heard_on}: start again")
    for palm, stroke in zip(PALMS, strokes, strict=True):
        pad = pads.of(palm)
        if stroke.heard_on != palm:
            yield f"  pads.palm{palm}: port: {pads.of(stroke.heard_on).port}    # the pads are swapped"
        axis, sign = _direction(palm, stroke)
        if axis != pad.axis:
            yield f"  pads.palm{palm}: axis: {axis}    # the other one lies across the palm"
        if sign != pad.sign:
            yield f"  pads.palm{palm}: sign: {sign}    # the pad is mirrored; then calibrate zero_mm"


def _direction(palm: int, stroke: FingerStroke) -> tuple[str, int]:
    """The axis along the palm, and whether its counts grow outwards, as s does."""
    x, y = stroke.slid()
    if abs(x) >= STRAIGHT * abs(y) and x:
        return "x", 1 if x > 0 else -1
    if abs(y) >= STRAIGHT * abs(x) and y:
        return "y", 1 if y > 0 else -1
    raise CliError(
        RIG_FAILED, f"palm {palm}: the finger went {x} counts in x and {y} in y: slide straight along the palm"
    )
