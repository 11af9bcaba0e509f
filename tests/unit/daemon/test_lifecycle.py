"""The table of transitions."""

import pytest

from palmd.daemon.lifecycle import COMMANDED, TRANSITIONS, State, Trigger, next_state


def test_only_a_granted_arm_command_leads_to_a_commanded_arm():
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
