"""`palmd doctor` against the emulated rig as a process: the arm's conformance in real time, and the findings."""

import pytest
from harness import Client, LoneRig, palmd

from palmd.devices.armconformance import CHECKS

pytestmark = pytest.mark.rig

GENTLE = {"rate_deg_s": 60, "acceleration_deg_s2": 300}  # so that the test can exceed one cycle's clamp


def rigs(folder):
    rig = LoneRig(folder, {"limits": GENTLE}, "--seed", 3)
    with Client(rig.found["control"]) as rig.hand:
        yield rig
    rig.stop()


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    yield from rigs(tmp_path_factory.mktemp("doctor"))


@pytest.fixture
def own_rig(tmp_path):
    """A rig for a test that may leave the arm in a fault."""
    yield from rigs(tmp_path)


def doctor(*arguments):
    return palmd("doctor", *arguments)


def test_the_emulated_arm_conforms(own_rig):
    done = doctor("--arm-conformance", own_rig.config, "--yes")
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, f"{done.stdout}{done.stderr}rig: {own_rig.hand.do('status')}"
    assert f"{len(CHECKS)} of {len(CHECKS)} checks passed" in done.stdout
    assert own_rig.hand.do("status")["arm_state"] == "R"


def test_without_permission_no_tracking_is_requested(rig):
    starts = rig.hand.do("status")["starts"]
    done = doctor("--arm-conformance", "--port", rig.found["arm"])
    assert done.returncode != 0
    assert "--yes" in done.stderr
    assert rig.hand.do("status")["starts"] == starts


def test_an_arm_that_is_not_ready_is_not_examined(rig):
    rig.hand.do("inject", name="estop")
    try:
        done = doctor("--arm-conformance", rig.config, "--yes")
        listed = doctor(rig.config).stdout
    finally:
        rig.hand.do("clear", name="estop")
    assert done.returncode == 3
    assert "ESTOP" in done.stderr
    assert "checks passed" not in done.stdout
    assert next(line for line in listed.splitlines() if "arm answers" in line).startswith("missing")


def test_a_late_arm_does_not_conform(rig):
    rig.hand.do("inject", name="late", port="arm", strength=0.045)
    try:
        done = doctor("--arm-conformance", rig.config, "--yes")
    finally:
        rig.hand.do("clear", name="late", port="arm")
    assert done.returncode == 3
    assert "FAIL" in done.stdout or "within" in done.stdout


def test_findings_with_a_rig_on_the_ports(rig):
    lines = {line[13:31].strip(): line[:12].strip() for line in doctor(rig.config).stdout.splitlines()}
    wanted = ("pad 1 port", "pad 1 talks", "pad 2 talks", "arm port", "arm answers", "bus", "configuration")
    assert {what: lines[what] for what in wanted} == dict.fromkeys(wanted, "ok")
