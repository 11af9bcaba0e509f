"""Moves, explorations and jogs as context managers: the commands they send; an exception inside holds the palms."""

import pytest

from palmd.api.errors import PalmdError
from palmd.api.motion import RigJog, RigMotion
from palmd.bus.subscriber import Message


class Rig:
    """A daemon that grants every command and whose motion ends after a given number of messages."""

    def __init__(self, state="ready", lasts=3, becomes="tracking"):
        self.state, self._left, self._becomes = state, lasts, becomes
        self.asked, self.client = [], self

    def command(self, name, **args):
        self.asked.append((name, args))
        self.state = {"arm": "tracking", "hold": "hold", "stop": "ready"}.get(name, self.state)
        return {}

    def status(self):
        return {"state": self.state, "moving": False, "over": self._left <= 0} | GROUNDS

    def messages(self, *_topics):
        while True:
            self._left -= 1
            yield Message("palm/estimate", {"valid": True}, 0.0)
            state = self._becomes if self._left <= 0 else "tracking"
            fields = {"state": state, "coverage": 0.7, "reason": "all touched"} | GROUNDS
            yield Message("palm/state", fields, 0.0)

    def ask(self, name, args):
        self.asked.append((name, args))
        return {
            "ok": "whole_phi1_deg" not in args or abs(args["whole_phi1_deg"]) < 90.0,
            "error": "jog refused: too far",
        }

    @property
    def commands(self):
        return [name for name, _ in self.asked]


GROUNDS = {"faults": ["pad1-silent"], "severities": ["hold"], "hints": ["see to it"], "cause": ""}
EXPLORE = {"explore": {"coverage": 0.5, "time_limit_s": 9.0}}


def test_a_move_arms_runs_the_plan_to_its_end_and_stops():
    rig = Rig()
    with RigMotion(rig, "explore", EXPLORE) as motion:
        seen = list(motion)
    assert rig.commands == ["arm", "plan", "start", "stop"]
    assert "coverage: 0.5" in rig.asked[1][1]["text"]
    assert len(seen) == 3
    assert (motion.over, motion.coverage, motion.reason) == (True, 0.7, "all touched")


def test_leaving_the_block_waits_for_the_end_and_leaves_an_armed_arm_armed():
    rig = Rig(state="tracking")
    with RigMotion(rig, "move", {"move": {"phi1_deg": 40.0}, "duration_s": 1.0}) as motion:
        pass
    assert motion.over
    assert rig.commands == ["plan", "start"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_exception_inside_the_block_holds_the_palms(error):
    rig = Rig()
    with pytest.raises(error), RigMotion(rig, "explore", EXPLORE):
        raise error
    assert rig.commands == ["arm", "plan", "start", "hold", "stop"]


def test_a_motion_stopped_by_a_fault_reports_the_fault():
    rig = Rig(becomes="fault")
    with (
        pytest.raises(PalmdError, match="the state is fault: pad1-silent: see to it"),
        RigMotion(rig, "explore", EXPLORE),
    ):
        pass
    assert rig.commands[-2:] == ["hold", "stop"]


def test_a_rig_that_cannot_be_armed_gets_no_further_command():
    rig = Rig(state="idle")
    with pytest.raises(PalmdError, match="cannot move: the state is idle"), RigMotion(rig, "explore", EXPLORE):
        pass
    assert rig.commands == []


def test_a_jog_is_sent_in_small_steps_and_its_refusal_is_an_error():
    rig = Rig()
    with RigJog(rig) as jog:
        jog.turn(phi1_deg=1.0)
    steps = [args["phi1_deg"] for name, args in rig.asked if name == "jog"]
    assert sum(steps) == pytest.approx(1.0)
    assert max(steps) <= 0.4
    with pytest.raises(PalmdError, match="too far"), RigJog(rig) as jog:
        jog.turn(phi1_deg=120.0)
    assert rig.commands[-2:] == ["hold", "stop"]
