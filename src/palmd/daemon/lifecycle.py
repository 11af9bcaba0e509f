"""The daemon's states as a table of transitions. Pure."""

from __future__ import annotations

from enum import StrEnum


class State(StrEnum):
    """State of the daemon from the operator's point of view."""

    IDLE = "idle"
    READY = "ready"
    TRACKING = "tracking"
    HOLD = "hold"
    FAULT = "fault"


class Trigger(StrEnum):
    """Events that can change the state."""

    RIG_UP = "all ports open and the arm has answered hello"
    RIG_DOWN = "a port or the arm's link is lost"
    ARMED = "arm, granted by the controller"
    START = "start"
    HOLD = "hold, or a hold fault"
    STOP = "stop"
    STOP_FAULT = "a stop fault"
    CLEARED = "reset, and no stop fault remains"


TRANSITIONS: dict[tuple[State, Trigger], State] = {
    (State.IDLE, Trigger.RIG_UP): State.READY,
    (State.READY, Trigger.RIG_DOWN): State.IDLE,
    (State.READY, Trigger.ARMED): State.TRACKING,
    (State.READY, Trigger.STOP): State.READY,
    (State.READY, Trigger.STOP_FAULT): State.FAULT,
    (State.TRACKING, Trigger.START): State.TRACKING,
    (State.TRACKING, Trigger.HOLD): State.HOLD,
    (State.TRACKING, Trigger.STOP): State.READY,
    (State.TRACKING, Trigger.STOP_FAULT): State.FAULT,
    (State.HOLD, Trigger.START): State.TRACKING,
    (State.HOLD, Trigger.HOLD): State.HOLD,
    (State.HOLD, Trigger.STOP): State.READY,
    (State.HOLD, Trigger.STOP_FAULT): State.FAULT,
    (State.FAULT, Trigger.CLEARED): State.READY,
}
"""Every transition. A trigger without a transition in a state changes nothing; as a command it is refused."""

COMMANDED = frozenset({State.TRACKING, State.HOLD})
"""States in which the arm gets set-points."""


def next_state(state: State, trigger: Trigger) -> State | None:
    """The state after `trigger`, None if there is no such transition."""
    return TRANSITIONS.get((state, trigger))


def diagram() -> str:
    """The table as a Mermaid state diagram, for the documentation."""
    arrows = [f"    {a} --> {b}: {trigger}" for (a, trigger), b in TRANSITIONS.items()]
    return "\n".join(("stateDiagram-v2", f"    [*] --> {State.IDLE}", *arrows)) + "\n"
