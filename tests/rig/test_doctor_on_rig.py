"""`palmd doctor` against the emulated rig as a process: the findings, and the test of the arm in real time."""

import pytest
from harness import Client, LoneRig, palmd

pytestmark = pytest.mark.rig


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    rig = LoneRig(tmp_path_factory.mktemp("doctor"), {}, "--seed", 3)
    with Client(rig.found["control"]) as rig.hand:
        yield rig
    rig.stop()


def doctor(*arguments):
    return palmd("doctor", *arguments)


def test_the_arm_is_tested_by_a_small_motion(rig):
    done = doctor("arm", rig.config, "--yes")
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, f"{done.stdout}{done.stderr}rig: {rig.hand.do('status')}"
    answers, moves = done.stdout.splitlines()
    assert "state R (READY), answers after" in answers
    assert "palm 1 turned +1.0" in moves
    assert rig.hand.do("status")["arm_state"] == "R"


def test_without_permission_no_tracking_is_requested(rig):
    starts = rig.hand.do("status")["starts"]
    done = doctor("arm", rig.config)
    assert done.returncode == 1
    assert "--yes" in done.stderr
    assert rig.hand.do("status")["starts"] == starts


def test_an_arm_that_is_not_ready_is_not_moved(rig):
    rig.hand.do("inject", name="estop")
    try:
        done = doctor("arm", rig.config, "--yes")
        listed = doctor(rig.config).stdout
    finally:
        rig.hand.do("clear", name="estop")
    assert done.returncode == 3
    assert "ESTOP" in done.stdout
    assert "arm moves" not in done.stdout
    assert next(line for line in listed.splitlines() if "arm answers" in line).startswith("missing")


def test_findings_with_a_rig_on_the_ports(rig):
    lines = {line[13:31].strip(): line[:12].strip() for line in doctor(rig.config).stdout.splitlines()}
    wanted = ("pad 1 port", "pad 1 talks", "pad 2 talks", "arm port", "arm answers", "bus", "configuration")
    assert {what: lines[what] for what in wanted} == dict.fromkeys(wanted, "ok")
