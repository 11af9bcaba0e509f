"""Which (state, fault, command) have been seen, and which of them can never be: with the reason. Pure.

What is said of the arm's faults is compared with all that the lifecycle's exhaustive check comes to
(`tests/unit/daemon/test_lifecycle_exhaustive.py`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from palmd.daemon.commands import COMMANDS
from palmd.daemon.lifecycle import COMMANDED, State
from palmd.faults import FAULTS, Fault, Severity
from tools.studies.simulation.causes import CAUSES

Triple = tuple[str, str, str]

_NO_LINK = ("arm-mute", "arm-link-lost", "arm-port")
_NO_PORT = ("pad1-port", "pad2-port")
_NEEDS_TRACKING = (
    *("pad1-silent", "pad2-silent", "pad1-lifted", "pad2-lifted"),
    *("arm-left-tracking", "arm-late", "arm-held", "estimate-lost", "estimate-inconsistent"),
)
_NEVER_CAUSED = {
    "arm-uncalibrated": "the emulated controller never loses its calibration",
    "arm-servo-": "only servos have it",
    "pad3-": "only three palms in space have such a pad",
    "-handshake": "the simulated pads are configured without a start-up that they would have to answer",
    "-foreign-clock": "only input devices stamp what they say",
    "rig-contradicted": "only a smoother tells it, and the simulation has none",
    "vm-backend": "it is told by the process round the loop, which the simulation does without",
    "no-realtime": "it is told by the process round the loop, which the simulation does without",
}
"""By what its code contains: why nothing in the simulation can cause a fault."""


def unreachable(state: State, fault: Fault | None) -> str | None:
    """Why a command can never find this fault in this state, None where it can."""
    return None if behind_a_stop(state, fault) else _after_no_tick(state, fault)


def behind_a_stop(state: State, fault: Fault | None) -> bool:
    """Whether a command finds it so only behind a `stop` in the same tick, and before the faults are judged anew."""
    if state is not State.READY or _after_no_tick(state, fault) is None:
        return False
    return any(_after_no_tick(commanded, fault) is None for commanded in COMMANDED)


def _after_no_tick(state: State, fault: Fault | None) -> str | None:
    """Why no tick leaves this fault in this state, None where one does."""
    if fault is None:
        return None
    code = fault.code
    if code not in CAUSES:
        return next(why for part, why in _NEVER_CAUSED.items() if part in code)
    if fault.severity is Severity.STOP and state in COMMANDED:
        return "a stop fault ends tracking in the tick that it comes up in, before the next command is heard"
    if fault.severity is Severity.HOLD and state is State.TRACKING:
        return "a hold fault leads to hold in the tick that it comes up in"
    if fault.severity is Severity.STOP and fault.latch == "always" and state is State.READY:
        return "a stop fault that latches leads from ready to fault in the tick that it comes up in"
    if code in (*_NO_LINK, *_NO_PORT) and state is State.READY:
        return "ready is left in the tick in which a port or the link is gone"
    if code == "arm-mute" and state in COMMANDED:
        return "the link, once found, is not mute but lost"
    if code in _NEEDS_TRACKING and state in (State.IDLE, State.READY):
        return "it is judged while the arm is commanded, and from there it takes another tick than the one to get here"
    return None


def rows() -> Iterator[tuple[State, Fault | None, str]]:
    """Every combination that the tables give."""
    for state in State:
        for fault in (None, *FAULTS):
            for command in COMMANDS:
                yield state, fault, command


def never_reached(seen: Counter[Triple]) -> tuple[list[Triple], dict[str, int], int]:
    """What was not seen though nothing speaks against it; how many are out of reach, by reason; how many were seen.

    What was seen although it should be out of reach is among the first, marked.
    """
    missing: list[Triple] = []
    reasons: Counter[str] = Counter()
    found = 0
    for state, fault, command in rows():
        code = "none" if fault is None else fault.code
        why = unreachable(state, fault)
        was_seen = (str(state), code, command) in seen
        if why is not None and not was_seen:
            reasons[why] += 1
        elif why is not None:
            missing.append((str(state), code, f"{command} (seen, though: {why})"))
        elif was_seen:
            found += 1
        else:
            missing.append((str(state), code, command))
    return missing, dict(reasons), found
