"""`palmd calibrate arm`, then `palmd calibrate gravity`, on a rig that differs from its configuration.

`tests/unit/calibration` tests both without real time.
"""

import cmath
import math

import pytest
import yaml
from harness import Client, Process, free_ports, palmd, wait

from palmd.config.two_palms import Config
from palmd.harness.stack import Stack

pytestmark = [pytest.mark.rig, pytest.mark.nightly]

BASE_MM = (120.0, 0.0)
TRUE_RIG = {"palm1_length_mm": 120.0, "palm2_length_mm": 120.0, "gravity_m_s2": 9.6}
TRUE_ARM = {"base_x_mm": -300.0, "base_y_mm": 20.0, "base_yaw_deg": 2.0}
ATTEMPTS = 5  # retries after a busy machine has delayed the rig


class Stand(Stack):
    child = Process


@pytest.fixture
def stack(tmp_path):
    """The true rig, not yet started, and other processes of a test."""
    with Stand(tmp_path, configured(TRUE_RIG, TRUE_ARM)) as stack:
        yield stack


def configured(rig, arm):
    publish, command = (f"tcp://127.0.0.1:{port}" for port in free_ports(2))
    pads = {f"palm{i}": {"port": f"pad{i}"} for i in (1, 2)}
    return Config.model_validate(
        {"rig": {"base_mm": list(BASE_MM), **rig}, "pads": pads, "arm": {"port": "arm", **arm}}
        | {"bus": {"publish": publish, "command": command}}
    )


def calibrate(stack, *arguments, mend=lambda: None):
    """Repeats until the command succeeds or the rig was not delayed; `mend` undoes the effect of a failed attempt."""
    for attempt in range(ATTEMPTS):
        stalls = stack.rig_status()["stalls"]
        done = palmd("calibrate", *arguments, timeout_s=240.0)
        if done.returncode == 0 or stack.rig_status()["stalls"] == stalls:
            break
        print(f"attempt {attempt}: {done.stderr}")
        mend()
    assert done.returncode == 0, done.stderr
    return done


def base_for(yaw_deg, palm_base):
    """Position (mm) of an arm with this yaw so that the palms' base is at palm_base in its coordinates (complex)."""
    base = complex(*BASE_MM) - palm_base * cmath.exp(1j * math.radians(yaw_deg))
    return {"base_x_mm": base.real, "base_y_mm": base.imag, "base_yaw_deg": yaw_deg}


def ready(client):
    """Waits until the daemon is ready, after clearing faults of an earlier attempt."""

    def look():
        state = client.do("status")["state"]
        if state == "fault":
            client.ask("reset")
        return state == "ready"

    wait(look, "the daemon being ready")


@pytest.fixture
def palm_base():
    """The palms' base in the true arm's coordinates (mm, complex)."""
    offset = complex(*BASE_MM) - complex(TRUE_ARM["base_x_mm"], TRUE_ARM["base_y_mm"])
    return offset * cmath.exp(-1j * math.radians(TRUE_ARM["base_yaw_deg"]))


def test_the_arm_is_calibrated_while_a_hand_swings_it(stack, tmp_path, palm_base):
    stack.start_rig("--by-hand", "--seed", "4")
    wrong = {"palm1_length_mm": 123.0, "palm2_length_mm": 117.0}
    stack.configure(configured(wrong, {"base_x_mm": -308.0, "base_y_mm": 14.0, "base_yaw_deg": 0.0}), stack.rig_info)
    calibrate(stack, "arm", stack.path, "--seconds", 16)
    result = yaml.safe_load((tmp_path / "calibration/arm.yaml").read_text())
    found, called_for = result["found"], result["configuration"]
    assert called_for["rig"]["palm1_length_mm"] == pytest.approx(120.0, abs=0.2)
    assert called_for["rig"]["palm2_length_mm"] == pytest.approx(120.0, abs=0.2)
    assert complex(found["base_x_mm"], found["base_y_mm"]) == pytest.approx(palm_base, abs=0.2)
    expected = base_for(0.0, palm_base)  # the command does not determine the yaw
    assert [called_for["arm"][f"base_{axis}_mm"] for axis in "xy"] == pytest.approx(
        [expected[f"base_{axis}_mm"] for axis in "xy"], abs=0.2
    )
    assert abs(found["tool_deg"]) < 0.1
    assert found["rms_mm"] < 0.05


def test_gravity_and_yaw_are_calibrated_with_a_ball(stack, tmp_path, palm_base):
    stack.start_rig("--roller", "ball", "--seed", "4")
    stack.configure(configured(TRUE_RIG | {"gravity_m_s2": 9.9}, base_for(0.0, palm_base)), stack.rig_info)
    stack.begin_daemon()
    with Client(stack.bus.command) as client:
        ready(client)
        arguments = ("gravity", stack.path, "--rolls", 4, "--clear", 0.4)
        calibrate(stack, *arguments, mend=lambda: ready(client))
        assert client.do("status")["state"] == "ready"
    assert "Traceback" not in stack.children["daemon"].all_said
    result = yaml.safe_load((tmp_path / "calibration/gravity.yaml").read_text())
    found, called_for = result["found"], result["configuration"]
    assert found["yaw_error_deg"] == pytest.approx(2.0, abs=0.1)
    assert abs(found["gravity_m_s2"] - 9.6) < 4.0 * found["gravity_sd_m_s2"] < 0.4  # few rolls, for speed
    assert called_for["arm"]["base_x_mm"] == pytest.approx(TRUE_ARM["base_x_mm"], abs=0.2)
    assert called_for["arm"]["base_y_mm"] == pytest.approx(TRUE_ARM["base_y_mm"], abs=1.0)  # 0.1° of yaw
