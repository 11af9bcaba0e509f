"""Kinds of pads and actuators: found by name, and all that stands in the folder keeps the protocol."""

import inspect
from pathlib import Path
from typing import get_args

import pytest
from pad_bench import KINDS as PADS
from pydantic import Discriminator, Tag

from palmd import devices
from palmd.config.arms import AdeptConfig, ArmConfig, DynamixelConfig, FeetechConfig
from palmd.config.pads import PadConfig, VersaPadConfig
from palmd.devices.actuator import Actuator, ArmState, Outgoing, Pose, make_actuator
from palmd.devices.armlink import Ack, HelloReply, encode_reply, parse_command
from palmd.devices.pad import PadDriver, make_pad
from palmd.devices.versapad import encode_packet
from palmd.events import PadLift, PadSample

FOLDER = Path(devices.__file__).parent
BREAK_S, ANSWER_S = 0.4, 1.0


def kinds(folder):
    return {path.stem for path in (FOLDER / folder).glob("*.py")} - {"__init__"}


def kinds_in(union):
    """The kinds of a model, or of a union of them, however they are told apart."""
    if isinstance(union, type):
        return set(get_args(union.model_fields["kind"].annotation))
    return {kind for each in get_args(union) if not isinstance(each, Discriminator | Tag) for kind in kinds_in(each)}


def members(protocol):
    own = {name for name in vars(protocol) if not name.startswith("_")}
    return own | set(inspect.get_annotations(protocol))


def test_every_file_has_its_configuration_model_and_the_other_way_round():
    assert kinds("pads") == kinds_in(PadConfig)
    assert kinds("actuators") == kinds_in(ArmConfig)


def test_every_kind_has_its_emulated_far_side():
    assert kinds("../rig/padkinds") == kinds_in(PadConfig)
    assert kinds("../rig/servokinds") - {"dynamixel_table"} == kinds_in(ArmConfig) - {"adept"}


@pytest.mark.parametrize(
    ("protocol", "driver"),
    [
        *((PadDriver, make_pad(2, config)) for config in PADS.values()),
        (Actuator, make_actuator(AdeptConfig(port="b"))),
        (Actuator, make_actuator(DynamixelConfig(kind="dynamixel", port="b"))),
        (Actuator, make_actuator(FeetechConfig(kind="feetech", port="b"))),
    ],
)
def test_a_driver_has_all_that_its_protocol_asks_for(protocol, driver):
    assert len(members(protocol)) > 10
    assert {name for name in members(protocol) if not hasattr(driver, name)} == set()


class FakePort:
    def __init__(self):
        self.breaks = []

    def set_break(self, active):
        self.breaks.append(active)


def pad(**values):
    return make_pad(1, VersaPadConfig(port="a", **values))


def test_a_pad_goes_from_bytes_to_events_and_counts():
    driver = pad()
    driver.opened(0.0)
    (sample,) = driver.feed(encode_packet(0, 0, 50), 1.0)
    assert isinstance(sample, PadSample)
    assert driver.touching
    assert driver.touch_end is None
    assert driver.view(1.0).s == sample.s == pytest.approx(0.028)
    assert driver.counts()["packets"] == 1
    (lift,) = driver.poll(1.2)
    assert isinstance(lift, PadLift)
    assert driver.touch_end == "silent"


def test_the_end_of_the_port_ends_the_touch():
    driver = pad()
    driver.opened(0.0)
    driver.feed(encode_packet(0, 0, 50), 1.0)
    assert driver.lost(1.01) == [PadLift(1.01, 1)]
    assert not driver.is_open
    assert not driver.touching


def test_garbage_is_told_at_the_next_look_and_only_then():
    driver = pad()
    driver.opened(0.0)
    driver.feed(b"\x3f" * 100, 1.0)
    assert list(driver.health(False)) == []
    assert list(driver.health(True)) == ["garbled"]
    assert list(driver.health(False)) == ["garbled"]
    assert "100 bytes, but no report among them at 9600 baud" in driver.diagnosis
    assert list(driver.health(True)) == []


def test_a_handshake_holds_the_port_in_break_and_complains_without_an_answer(monkeypatch):
    monkeypatch.setattr("palmd.devices.pads.versapad.Port", FakePort)
    driver, port = pad(handshake="break"), FakePort()
    driver.opened(0.0)
    for i in range(200):
        driver.reports(b"", 0.01 * i)
        driver.tend(port, 0.0)
    assert port.breaks == [True, False]
    assert not driver.starting
    assert "no identity" in driver.diagnosis
    assert list(driver.health(False)) == ["handshake"]


def test_an_actuator_says_what_it_sent():
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
    assert setpoints[0].t_rad == pytest.approx(0.3, abs=1e-5), "where the arm is, not where it was told to go"
    assert len(setpoints) > 100
    assert setpoints[-1].t_rad == pytest.approx(0.3 + 0.01 * t, abs=1e-3)
