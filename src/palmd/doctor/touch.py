"""Touch test: finds by a finger which pad is which, which axis lies along the palm, and its sign."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from palmd.config.two_palms import PadsConfig
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError, as_cli_error
from palmd.devices.pad import PadReport
from palmd.devices.padlistener import PadListener
from palmd.devices.port import PortUnavailableError, PortWaiter
from palmd.system.mechanism import HELD_BY, PALMS

TOUCH_WITHIN_S = 20.0
LIFTED_S = 0.5
"""Silence (s) that ends a stroke."""

FEWEST_REPORTS = 12
STRAIGHT = 2.0
"""Smallest ratio of a stroke's lengths along both axes."""

_LOOK_S = 0.02


@dataclass(frozen=True, slots=True)
class FingerStroke:
    """Counts of the reports, in order, of a finger that slid over a pad from the hinge outwards."""

    received_on: int  # palm number according to the configuration
    x: tuple[int, ...]
    y: tuple[int, ...]

    def slid(self) -> tuple[int, int]:
        """Displacement along x and y (counts), from the mean of the first fifth to that of the last."""
        fifth = max(1, len(self.x) // 5)
        along_x, along_y = (sum(c[-fifth:]) - sum(c[:fifth]) for c in (self.x, self.y))
        return round(along_x / fifth), round(along_y / fifth)


def examine_pads(path: Path, pads: PadsConfig) -> int:
    """Ask for a stroke on each pad and print what to change; return 0 if nothing, else 1.

    CliError if a port cannot be opened, or no pad is touched.
    """
    strokes: list[FingerStroke] = []
    with as_cli_error(PortUnavailableError, status=RIG_FAILED), ExitStack() as stack:
        listeners = {palm: stack.enter_context(PadListener(palm, pads.of(palm))) for palm in PALMS}
        for palm, held in zip(PALMS, HELD_BY, strict=True):
            which = f"palm {palm}, the one {held}"
            print(
                f"{which}: put a finger on its pad near the hinge between the palms, slide outwards, lift",
                flush=True,
            )
            strokes.append(_stroke(palm, listeners))
    lines = list(changes(strokes, pads))
    if not lines:
        print(f"both pads match {path}")
        return 0
    print(f"change in {path}:")
    print("\n".join(lines))
    return BAD_INPUT


def _stroke(palm: int, listeners: Mapping[int, PadListener]) -> FingerStroke:
    """Return the next stroke, on any pad; CliError for a touch of both at once or none in time."""
    waiter = PortWaiter([listener.port for listener in listeners.values()])
    received: dict[int, list[PadReport]] = {number: [] for number in listeners}
    t = time.monotonic()
    t_end = t + TOUCH_WITHIN_S
    while t < t_end:
        waiter.wait(min(t + _LOOK_S, t_end))
        for number, listener in listeners.items():
            packets = [report for report in listener.read() if report.in_use]
            received[number] += packets
            if packets:
                t_end = time.monotonic() + LIFTED_S
        t = time.monotonic()
    touched = [each for each, packets in received.items() if len(packets) >= FEWEST_REPORTS]
    if len(touched) != 1:
        what = "both pads were touched at once" if touched else f"no stroke within {TOUCH_WITHIN_S:.0f} s"
        raise CliError(RIG_FAILED, f"palm {palm}: {what}; start again with palmd doctor --touch")
    packets = received[touched[0]]
    print(f"  heard on the port of pads.palm{touched[0]}, {len(packets)} reports", flush=True)
    return FingerStroke(
        touched[0], tuple(packet.x_counts for packet in packets), tuple(packet.y_counts for packet in packets)
    )


def changes(strokes: Sequence[FingerStroke], pads: PadsConfig) -> Iterator[str]:
    """Yield the changes of the configuration that follow from a stroke on palm 1 and then one on palm 2. Pure.

    CliError for ambiguous strokes: both on one pad, or neither along x nor along y.
    """
    if len({stroke.received_on for stroke in strokes}) < len(strokes):
        raise CliError(RIG_FAILED, f"both strokes were received on pads.palm{strokes[0].received_on}: start again")
    for palm, stroke in zip(PALMS, strokes, strict=True):
        pad = pads.of(palm)
        if stroke.received_on != palm:
            yield f"  pads.palm{palm}: port: {pads.of(stroke.received_on).port}    # the pads are swapped"
        axis, sign = _direction(palm, stroke)
        if axis != pad.axis:
            yield f"  pads.palm{palm}: axis: {axis}    # the other one lies across the palm"
        if sign != pad.sign:
            yield f"  pads.palm{palm}: sign: {sign}    # the pad is mirrored; then calibrate zero_mm"


def _direction(palm: int, stroke: FingerStroke) -> tuple[str, int]:
    """Return the axis along the palm, and 1 if its counts increase outwards, as s does, else -1."""
    x, y = stroke.slid()
    if abs(x) >= STRAIGHT * abs(y) and x:
        return "x", 1 if x > 0 else -1
    if abs(y) >= STRAIGHT * abs(x) and y:
        return "y", 1 if y > 0 else -1
    raise CliError(
        RIG_FAILED, f"palm {palm}: the finger went {x} counts in x and {y} in y: slide straight along the palm"
    )
