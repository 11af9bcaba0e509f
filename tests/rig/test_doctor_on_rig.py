"""`palmd doctor` against the emulated rig as a process: the arm's conformance in real time, and the findings."""

import json
import subprocess
import sys

import pytest
import yaml
from harness import Client, Process

from palmd.devices.armconformance import CHECKS

pytestmark = pytest.mark.rig

GENTLE = {"rate_deg_s": 60, "acceleration_deg_s2": 300}  # so that one cycle's clamp is within reach of the test


class Rig:
    def __init__(self, folder):
        settings = {"pads": {"palm1": {"port": "a"}, "palm2": {"port": "b"}}, "arm": {"port": "c"}, "limits": GENTLE}
        (folder / "rig.yaml").write_text(yaml.safe_dump(settings))
        self._process = Process(["rig", folder / "rig.yaml", "--seed", 3], folder)
        self.found = json.loads(self._process.first_line())
        self.hand = Client(self.found["control"])
        bus = {"publish": f"ipc://{folder}/publish", "command": f"ipc://{folder}/command"}
        pads = {"palm1": {"port": self.found["pad1"]}, "palm2": {"port": self.found["pad2"]}}
        settings |= {"pads": pads, "arm": {"port": self.found["arm"]}, "bus": bus}
        self.config = folder / "palmd.yaml"
        self.config.write_text(yaml.safe_dump(settings))

    def close(self):
        self.hand.close()
        self._process.stop()


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    rig = Rig(tmp_path_factory.mktemp("doctor"))
    yield rig
    rig.close()


@pytest.fixture
def own_rig(tmp_path):
    """For a test that may leave the arm in a fault."""
    rig = Rig(tmp_path)
    yield rig
    rig.close()


def doctor(*arguments):
    return subprocess.run(
        [sys.executable, "-P", "-m", "palmd", "doctor", *map(str, arguments)],
        capture_output=True, text=True, timeout=100, check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip


def test_the_emulated_arm_conforms(own_rig):
    done = doctor("--arm-conformance", own_rig.config, "--yes")
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, f"{done.stdout}{done.stderr}rig: {own_rig.hand.do('status')}"
    assert f"{len(CHECKS)} of {len(CHECKS)} checks passed" in done.stdout
    assert own_rig.hand.do("status")["arm_state"] == "R"


def test_without_leave_nothing_is_told_to_track(rig):
    starts = rig.hand.do("status")["starts"]
    done = doctor("--arm-conformance", "--port", rig.found["arm"])
    assert done.returncode != 0
    assert "--yes" in done.stderr
    assert rig.hand.do("status")["starts"] == starts


def test_an_arm_that_is_not_ready_is_not_examined(rig):
    rig.hand.do("mischief", name="estop")
    try:
        done = doctor("--arm-conformance", rig.config, "--yes")
        listed = doctor(rig.config).stdout
    finally:
        rig.hand.do("calm", name="estop")
    assert done.returncode == 3
    assert "ESTOP" in done.stderr
    assert "checks passed" not in done.stdout
    assert next(line for line in listed.splitlines() if "arm answers" in line).startswith("missing")


def test_a_late_arm_does_not_conform(rig):
    rig.hand.do("mischief", name="late", port="arm", strength=0.045)
    try:
        done = doctor("--arm-conformance", rig.config, "--yes")
    finally:
        rig.hand.do("calm", name="late", port="arm")
    assert done.returncode == 3
    assert "FAIL" in done.stdout or "within" in done.stdout


def test_the_list_with_a_rig_behind_the_ports(rig):
    lines = {line[13:31].strip(): line[:12].strip() for line in doctor(rig.config).stdout.splitlines()}
    wanted = ("pad 1 port", "pad 1 talks", "pad 2 talks", "arm port", "arm answers", "bus", "configuration")
    assert {what: lines[what] for what in wanted} == dict.fromkeys(wanted, "ok")
