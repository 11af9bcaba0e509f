"""Possible causes of each fault, defined independently of the daemon, to find faults without a cause. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from palmd.rig.fault_injection import PADS
from tools.studies.simulation.scenario import (
    Broken,
    Bytes,
    ClientRequest,
    RandomEvent,
    Restart,
    ScheduledFault,
    Slow,
    Stall,
)

LINGERS_S = 3.0
"""A cause may still trigger a fault this long after its end (s): ports are retried, counters judged, links found."""

_LINE = frozenset({"drop", "garble", "mute", "unplug", "late", "burst", "misbaud", "bytes"})
_BODY = frozenset({"lift", "swap", "left"})
"""Events of the body; `left`: it leaves the palms by itself, for example at a pad's end."""
_HOST = frozenset({"stall", "restart", "broken"})
_DAMAGED = frozenset({"drop", "garble", "misbaud", "bytes", "unplug", "mute"})

_ARM_LINE = frozenset(f"{what}@arm" for what in _LINE)
_CONTROLLER = frozenset({"estop@arm", "power_off@arm", "manual@arm", "break@arm"})


_PRESSED = frozenset(f"{what}@{pad}" for what in ("saturate", "touch") for pad in PADS)


def _pad(pad: str) -> dict[str, frozenset[str]]:
    line, damaged = (frozenset(f"{what}@{pad}" for what in names) for names in (_LINE, _DAMAGED))
    return {
        f"{pad}-port": frozenset({f"unplug@{pad}", "restart"}),
        f"{pad}-silent": line | _BODY | {"stall"},
        f"{pad}-lifted": line | _BODY,
        f"{pad}-untouched": line | _BODY | _HOST,
        f"{pad}-garbled": damaged,
        f"{pad}-out-of-range": damaged | {f"touch@{pad}"},
        f"{pad}-batched": frozenset({f"burst@{pad}", f"late@{pad}", f"bytes@{pad}", "stall", "restart"}),
    }


CAUSES: dict[str, frozenset[str]] = {
    "tick-error": frozenset({"broken"}),
    "estimate-not-finite": frozenset({"broken"}),
    "loop-overruns": frozenset({"stall"}),
    "loop-overrun": frozenset({"stall", "restart"}),
    "arm-estop": frozenset({"estop@arm"}),
    "arm-power-off": frozenset({"power_off@arm"}),
    "arm-manual": frozenset({"manual@arm"}),
    "arm-fault": _ARM_LINE | _HOST | _CONTROLLER,
    "arm-port": frozenset({"unplug@arm", "restart"}),
    "arm-link-lost": _ARM_LINE | {"stall", "restart"},
    "arm-left-tracking": _ARM_LINE | _CONTROLLER | {"stall"},
    "arm-mute": _ARM_LINE | {"stall", "restart"},
    "arm-late": _ARM_LINE | {"stall"},
    "arm-held": _ARM_LINE | {"stall"},
    "arm-garbled": frozenset(f"{what}@arm" for what in _DAMAGED),
    "following-error": frozenset({"block@arm", "freeze@arm", "jump@arm"}),
    "pose-implausible": frozenset({"jump@arm", "block@arm"}),
    "limits-violated": frozenset({"jump@arm"}),
    "pose-contradicts-rig": frozenset({"jump@arm"}),
    "force-limit": _PRESSED,
    "force-excess": _PRESSED,
    **_pad(PADS[0]),
    **_pad(PADS[1]),
    "plan-refused": frozenset({"request"}),
    "operator-lost": frozenset({"request"}),
    "smoother-silent": frozenset({"slow"}),
    "explorer-silent": frozenset({"slow", "broken", "request"}),
    "pads-swapped": _PRESSED,
    "pads-mirrored": _PRESSED | frozenset(_BODY),  # a finger and another object move differently
    "estimate-lost": frozenset({"broken", "request", *_BODY, *_PRESSED, "block@arm", "freeze@arm", "jump@arm"})
    | {f"{what}@{pad}" for what in _LINE for pad in PADS},
    "estimate-inconsistent": frozenset({"broken", *_BODY, *_PRESSED, "block@arm", "freeze@arm", "jump@arm"})
    | {f"{what}@{end}" for what in _LINE for end in (*PADS, "arm")},
    "samples-too-late": frozenset({"stall", "restart"}) | {f"{what}@{pad}" for what in _LINE for pad in PADS},
    "recorder-failed": frozenset({"request"}),
    "recorder-silent": frozenset({"request"}),
}
"""For each fault the events that may cause it. A fault that is missing here has no cause in any simulated run."""

FOR_GOOD = frozenset({"recorder-failed", "recorder-silent", "plan-refused"})
"""Faults that last until the client's next request."""


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause that acted from `t_on` to `t_off` (s)."""

    name: str
    t_on: float
    t_off: float


def causes(events: Iterable[RandomEvent]) -> Iterator[Cause]:
    """The cause of each event."""
    for each in events:
        match each:
            case ScheduledFault():
                name = each.name if each.port is None else f"{each.name}@{each.port}"
                yield Cause(name, each.t, each.t + each.for_s)
            case Bytes():
                yield Cause(f"bytes@{each.port}", each.t, each.t + 1.0)
            case Stall():
                yield Cause("stall", each.t, each.t + each.for_s)
            case Restart():
                yield Cause("restart", each.t, each.t + each.after_s)
            case Broken():
                yield Cause("broken", each.t, each.t + each.for_s)
            case Slow():
                yield Cause("slow", each.t, each.t + each.for_s + each.takes_s)
            case ClientRequest():
                yield Cause("request", each.t, float("inf"))
