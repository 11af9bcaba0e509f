"""Kinds of pads and actuators: found by name, each with its configuration and its emulation."""

from pathlib import Path
from typing import get_args

import pytest
from pydantic import Discriminator, Tag

from palmd import devices
from palmd.config.arms import AdeptConfig, ArmConfig
from palmd.config.pads import PadConfig
from palmd.devices.actuator import ArmState, Outgoing, Pose, make_actuator
from palmd.devices.armlink import Ack, HelloReply, encode_reply, parse_command

FOLDER = Path(devices.__file__).parent


def kinds(folder):
    return {path.stem for path in (FOLDER / folder).glob("*.py")} - {"__init__"}


def kinds_in(union):
    """The kinds of a model, or of a union of models, however they are discriminated."""
    if isinstance(union, type):
        return set(get_args(union.model_fields["kind"].annotation))
    return {kind for each in get_args(union) if not isinstance(each, Discriminator | Tag) for kind in kinds_in(each)}


def test_every_driver_has_a_configuration_model_and_vice_versa():
    assert kinds("pads") == kinds_in(PadConfig)
    assert kinds("actuators") == kinds_in(ArmConfig)


def test_every_kind_has_its_emulation():
    assert kinds("../rig/padkinds") == kinds_in(PadConfig)
    assert kinds("../rig/servokinds") - {"dynamixel_table"} == kinds_in(ArmConfig) - {"adept"}


def test_an_actuator_returns_the_set_point_that_it_sent():
    arm = make_actuator(AdeptConfig(port="a"))
    far = Pose(0.1, 0.2, 0.3)
    arm.poll(0.0, None)
    arm.feed(encode_reply(HelloReply(0.016, -1, 1, -2, 2, 0.5, 5)), 0.01)
    assert arm.reach.y_max_m == 2.0
    t, setpoints = 0.01, []
    arm.request_tracking()
    for _ in range(2000):
        t += 0.001
        sent = arm.poll(t, Pose(0.1, 0.2, 0.3 + 0.01 * t))
        assert isinstance(sent, Outgoing)
        assert (b"S" in sent.data) is (sent.setpoint is not None)
        if sent.setpoint is not None:
            setpoints.append(sent.setpoint)
        for line in sent.data.splitlines():
            command = parse_command(line.decode().split("*")[0])
            if hasattr(command, "ss"):
                arm.feed(encode_reply(Ack(command.ss, ArmState.TRACKING, far)), t)
    assert setpoints[0].t_rad == pytest.approx(0.3, abs=1e-5), "the arm's actual angle, not its target"
    assert len(setpoints) > 100
    assert setpoints[-1].t_rad == pytest.approx(0.3 + 0.01 * t, abs=1e-3)
