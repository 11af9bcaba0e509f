"""The table of transitions."""

import pytest

from palmd.daemon.lifecycle import COMMANDED, TRANSITIONS, State, Trigger, diagram, next_state


def walk(*triggers: Trigger) -> list[State]:
    states = [State.IDLE]
    for trigger in triggers:
        state = next_state(states[-1], trigger)
        assert state is not None, (states[-1], trigger)
        states.append(state)
    return states


def test_a_day_at_the_rig():
    t = Trigger
    assert walk(t.RIG_UP, t.ARMED, t.START, t.HOLD, t.START, t.STOP_FAULT, t.CLEARED, t.RIG_DOWN) == [
        "idle", "ready", "tracking", "tracking", "hold", "tracking", "fault", "ready", "idle",
    ]  # fmt: skip


def test_only_a_granted_arm_leads_to_a_commanded_arm():
    ways_in = {
        trigger for (state, trigger), after in TRANSITIONS.items() if after in COMMANDED and state not in COMMANDED
    }
    assert ways_in == {Trigger.ARMED}


@pytest.mark.parametrize("state", sorted(COMMANDED))
def test_stop_and_stop_faults_end_every_commanded_state(state):
    assert next_state(state, Trigger.STOP) is State.READY
    assert next_state(state, Trigger.STOP_FAULT) is State.FAULT


def test_only_reset_leads_out_of_fault():
    ways_out = [trigger for state, trigger in TRANSITIONS if state is State.FAULT]
    assert ways_out == [Trigger.CLEARED]


def test_what_is_not_in_the_table_changes_nothing():
    assert next_state(State.IDLE, Trigger.ARMED) is None
    assert next_state(State.READY, Trigger.START) is None


def test_every_state_can_be_reached_and_left():
    assert {state for state, _ in TRANSITIONS} == set(State)
    assert set(TRANSITIONS.values()) == set(State)


def test_diagram_has_every_transition():
    lines = diagram().splitlines()
    assert lines[:2] == ["stateDiagram-v2", "    [*] --> idle"]
    assert len(lines) == 2 + len(TRANSITIONS)
    assert "    ready --> tracking: arm, granted by the controller" in lines
