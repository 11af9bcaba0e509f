"""The study of false alarms: ordinary operation raises no fault, and a limit that is too narrow is found."""

import pytest

from tools.studies.false_alarms import STUDY, OperationTask, run


@pytest.mark.nightly
@pytest.mark.parametrize("rig", ["arm", "servos", "pivot"])
def test_jogging_holding_and_starting_on_a_busy_machine_raise_no_fault(rig):
    life = run(OperationTask(rig, 9000, 25.0, light=True))
    assert not life.error
    assert not life.guards
    assert life.moved_s > 10.0
    assert 0.0 < life.following_share < 1.0
    assert life.commands["start"] > 1


def test_a_limit_that_is_too_narrow_is_found(monkeypatch):
    monkeypatch.setattr("palmd.daemon.guards.following.FollowingLimits.joint", lambda *_: 1e-4)
    life = run(OperationTask("arm", 9000, 10.0, light=True))
    assert life.guards
    (goal,) = STUDY.goals
    assert not goal.met([life])
    assert "following-error" in "".join(STUDY.remarks([life]))
