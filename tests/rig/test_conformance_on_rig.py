"""`python -m tools.conformance` on the emulated rig as a process, in real time."""

import subprocess
import sys
from pathlib import Path

import pytest
from harness import Client, LoneRig

from tools.conformance.arm_checks import CHECKS

pytestmark = pytest.mark.rig

GENTLE = {"rate_deg_s": 60, "acceleration_deg_s2": 300}  # so that the test can exceed one cycle's clamp


def conformance(rig, *options):
    command = [sys.executable, "-m", "tools.conformance", "arm", rig.found["arm"], *options]
    return subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=120)


@pytest.fixture
def rig(tmp_path):
    rig = LoneRig(tmp_path, {"limits": GENTLE}, "--seed", 3)
    with Client(rig.found["control"]) as rig.hand:
        yield rig
    rig.stop()


def test_the_emulated_arm_conforms(rig):
    done = conformance(rig, "--yes")
    assert done.returncode == 0, f"{done.stdout}{done.stderr}rig: {rig.hand.do('status')}"
    assert f"{len(CHECKS)} of {len(CHECKS)} checks passed" in done.stdout
    assert rig.hand.do("status")["arm_state"] == "R"


def test_without_permission_no_tracking_is_requested(rig):
    done = conformance(rig)
    assert done.returncode == 1
    assert "--yes" in done.stderr
    assert rig.hand.do("status")["starts"] == 0


def test_a_late_arm_does_not_conform(rig):
    rig.hand.do("inject", name="late", port="arm", strength=0.045)
    done = conformance(rig, "--yes")
    assert done.returncode == 3
    assert "FAIL" in done.stdout or "within" in done.stderr
