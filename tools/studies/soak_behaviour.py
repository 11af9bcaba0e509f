"""Whether all that the daemon did in a soak has a reason: its faults, its arming, its set-points. Pure."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from tools.studies.fault_reaction import ToldState
from tools.studies.soak import SoakFinding, at_most, between, told

COMMANDED = ("tracking", "hold")
BEFORE_S, AFTER_S = 0.1, 5.0
"""What a tick tells is dated with its beginning: what came within the tick looks later."""

HELD_UP_AFTER_S = 0.5
LONG_AFTER_S = 60.0  # an estimate takes its time to go wrong, and to come back
COMMAND_S = 2.0  # from a command to the state that it leads to
SETTLED_S = 0.5  # set-points that were under way when the state changed
REST_MOST_S = 60.0
"""An operator has the palms tracking again within this, or the soak is of a rig at rest."""

GRAVE = ("degrade", "hold", "stop")

_PAD = ("silent", "lifted", "untouched", "garbled", "out-of-range", "batched", "handshake")
_LINK = ("arm-late", "arm-held", "arm-garbled", "arm-link-lost", "arm-fault", "arm-left-tracking", "arm-mute")
PAD_CODES: dict[str, tuple[str, ...]] = {
    "drop": _PAD,
    "garble": _PAD,
    "mute": ("silent", "untouched", "batched"),
    "unplug": ("port", "silent", "untouched", "batched", "handshake"),
    "late": ("silent", "untouched", "batched"),
    "burst": ("silent", "untouched", "batched"),
    "misbaud": _PAD,
    "touch": ("out-of-range",),
    "parted": ("silent", "lifted", "untouched"),
    "batch": ("silent", "untouched", "batched"),
    "saturate": (),
}
PRESSED = ("touch", "saturate")
PRESSED_CODES = ("force-limit", "force-excess")
ARM_CODES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("drop", "garble", "mute", "late", "burst", "misbaud"), _LINK),
    "unplug": ("arm-port", *_LINK),
    "break": ("arm-fault", "arm-left-tracking"),
    "estop": ("arm-estop", "arm-left-tracking"),
    "power_off": ("arm-power-off", "arm-left-tracking"),
    "manual": ("arm-manual", "arm-left-tracking", "limits-violated"),
    "block": ("following-error", "pose-implausible"),
    "freeze": ("following-error",),
    "jump": ("following-error", "pose-implausible", "limits-violated", "pose-contradicts-rig"),
}
OBJECT_CODES = tuple(f"{pad}-{what}" for pad in ("pad1", "pad2") for what in ("silent", "lifted", "untouched"))
HELD_UP = ("stall", "batch")
"""Not mischief, but the machine: rig or ordinary processes were kept from their work, or the kernel kept bytes back."""

STALL_CODES = (*OBJECT_CODES, *_LINK, "pad1-batched", "pad2-batched")
LATER_CODES = ("estimate-lost", "estimate-inconsistent", "samples-too-late", "pads-swapped")


@dataclass(frozen=True, slots=True)
class PossibleCause:
    """Something that may bring faults, from t_on to t_off (s): a mischief of a port, or of the object (no port).

    Besides the rig's tricks there are `parted`, the object really left the pad, and those of `HELD_UP`.
    """

    name: str
    port: str | None
    t_on: float
    t_off: float

    def explains(self, code: str, t: float) -> bool:
        """Whether it may be why a fault came at `t` (s)."""
        if t < self.t_on - BEFORE_S:
            return False
        if code in LATER_CODES:
            return t <= self.t_off + LONG_AFTER_S
        after = HELD_UP_AFTER_S if self.name in HELD_UP else AFTER_S
        return t <= self.t_off + after and code in self._codes()

    def _codes(self) -> tuple[str, ...]:
        if self.name == "stall":
            return STALL_CODES
        if self.port == "arm":
            return ARM_CODES[self.name]
        if self.port is None:
            return OBJECT_CODES
        own = tuple(f"{self.port}-{what}" for what in PAD_CODES[self.name])
        return (*own, *PRESSED_CODES) if self.name in PRESSED else own


@dataclass(frozen=True, slots=True)
class GivenCommand:
    """An operator's command and when it was given (s)."""

    t: float
    name: str


@dataclass(frozen=True, slots=True)
class Counted:
    """A count of set-points at a time (s)."""

    t: float
    setpoints: int


def unexplained(states: Sequence[ToldState], causes: Sequence[PossibleCause]) -> list[str]:
    """Faults above a note that came when nothing had been done that explains them, `code after … s` each."""
    found = []
    for before, now in pairwise(states):
        for code, severity in now.faults.items():
            came = code not in before.faults
            if came and severity in GRAVE and not any(cause.explains(code, now.t) for cause in causes):
                found.append(f"{code} after {now.t - states[0].t:.1f} s")
    return found


def uncalled(states: Sequence[ToldState], commands: Sequence[GivenCommand]) -> list[str]:
    """Changes into tracking that nobody had asked for: neither armed nor, after a hold, started."""
    found = []
    for before, now in pairwise(states):
        if now.state == "tracking" and before.state != "tracking":
            wanted = "start" if before.state == "hold" else "arm"
            if not any(one.name == wanted and -BEFORE_S <= now.t - one.t <= COMMAND_S for one in commands):
                found.append(f"{before.state} to tracking without {wanted} after {now.t - states[0].t:.1f} s")
    return found


def longest_rest(states: Sequence[ToldState], t_end: float) -> float:
    """For how long (s) on end the arm was not tracking at most, until t_end."""
    longest, since = 0.0, math.inf
    for one in (*states, ToldState(t_end, "tracking", {})):
        if one.state == "tracking":
            longest, since = max(longest, one.t - since), math.inf
        else:
            since = min(since, one.t)
    return longest


def commanded_while_not(states: Sequence[ToldState], counted: Sequence[Counted]) -> int:
    """Set-points between two counts during which the state allowed none."""
    times = [told.t for told in states]
    total = 0
    for a, b in pairwise(counted):
        first = bisect_right(times, a.t - SETTLED_S) - 1
        last = bisect_right(times, b.t + BEFORE_S) - 1
        if first >= 0 and not any(told.state in COMMANDED for told in states[first : last + 1]):
            total += b.setpoints - a.setpoints
    return total


def behaviour(
    states: Sequence[ToldState],
    causes: Sequence[PossibleCause],
    commands: Sequence[GivenCommand],
    sent: Sequence[Counted],
    accepted: Sequence[Counted],
    end: str,
) -> list[SoakFinding]:
    """All that is to be said; `sent` and `accepted` are the daemon's and the controller's counts of set-points."""
    strange, alone = unexplained(states, causes), uncalled(states, commands)
    t_end = max(states[-1].t, sent[-1].t if sent else -math.inf)
    done = [cause for cause in causes if cause.name not in HELD_UP]
    came = sum(code not in a.faults for a, b in pairwise(states) for code in b.faults)
    return [
        told("behaviour", "mischiefs", sum(cause.name != "parted" for cause in done)),
        told("behaviour", "faults told", came),
        told("behaviour", "faults by the machine alone", len(unexplained(states, done)) - len(strange)),
        between("behaviour", "faults without a cause", len(strange), 0, 0, why=", ".join(strange[:8])),
        between("behaviour", "tracking without a command", len(alone), 0, 0, why=", ".join(alone[:8])),
        at_most("behaviour", "longest time without tracking", longest_rest(states, t_end), REST_MOST_S, "s"),
        between("behaviour", "set-points sent while not tracking", commanded_while_not(states, sent), 0, 0),
        between("behaviour", "set-points taken while not tracking", commanded_while_not(states, accepted), 0, 0),
        between("behaviour", "ended ready or held", float(end in ("ready", "hold")), 1, 1, why=f"it ended {end}"),
    ]
