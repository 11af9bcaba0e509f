"""The emulated servos, accessed by the maker's own library in virtual time."""

import math

import numpy as np
import pytest
from servo_bench import HOME, tabletop

from palmd.rig.line import Wire
from palmd.rig.servokinds.dynamixel import DynamixelArm

sdk = pytest.importorskip("dynamixel_sdk", reason="the maker's library (dynamixel-sdk) is not installed")

STEP_S = 5e-4
ID, BAUD, DRIVE, MODE, HOMING, MAX, MIN = 7, 8, 10, 11, 20, 48, 52
TORQUE, LED, LEVEL, WATCHDOG, PROFILE, GOAL, POSITION = 64, 65, 68, 98, 112, 116, 132
INSTRUCTION, RANGE, LENGTH, LIMIT, ACCESS = 2, 4, 5, 6, 7


class VirtualPort:
    """A stand-in for the library's serial port: the emulated servos, and time that passes while it waits."""

    def __init__(self):
        config = tabletop()
        self.arm = DynamixelArm(config, config.arm, HOME, np.random.default_rng(1), 0.0)
        self.is_using, self.t = False, 0.0
        self._out, self._in, self._t_end = Wire(config.arm.baud), b"", 0.0

    def pass_time(self, seconds):
        for _ in range(round(seconds / STEP_S)):
            self.t += STEP_S
            for said in self.arm.step(self.t):
                self._out.send(said.data, said.t)
            self._in += self._out.take(self.t)

    def writePort(self, packet):  # noqa: N802
        self.arm.receive(bytes(packet), bytes(packet), self.t)
        return len(packet)

    def readPort(self, length):  # noqa: N802
        self.pass_time(STEP_S)
        data, self._in = self._in[:length], self._in[length:]
        return list(data)

    def getBytesAvailable(self):  # noqa: N802
        self.pass_time(STEP_S)
        return len(self._in)

    def clearPort(self):  # noqa: N802
        self._in = b""

    def setPacketTimeout(self, packet_length):  # noqa: N802
        self._t_end = self.t + 1e-5 * packet_length + 0.034

    def setPacketTimeoutMillis(self, milliseconds):  # noqa: N802
        self._t_end = self.t + 1e-3 * milliseconds

    def isPacketTimeout(self):  # noqa: N802
        return self.t > self._t_end

    def getBaudRate(self):  # noqa: N802
        return 1_000_000


@pytest.fixture
def port():
    return VirtualPort()


@pytest.fixture
def bus():
    return sdk.PacketHandler(2.0)


def read(bus, port, servo, address, size=1):
    """The value; None without an answer, the error if there is one."""
    ask = {1: bus.read1ByteTxRx, 2: bus.read2ByteTxRx, 4: bus.read4ByteTxRx}[size]
    value, result, error = ask(port, servo, address)
    return None if result != sdk.COMM_SUCCESS else value if not error else f"error {error}"


def write(bus, port, servo, address, value, size=1):
    """The error, 0 if accepted, None without an answer."""
    send = {1: bus.write1ByteTxRx, 2: bus.write2ByteTxRx, 4: bus.write4ByteTxRx}[size]
    result, error = send(port, servo, address, value & (1 << 8 * size) - 1)
    return None if result != sdk.COMM_SUCCESS else error


def is_there(bus, port, servo):
    return bus.ping(port, servo)[1] == sdk.COMM_SUCCESS


def test_both_servos_are_found(bus, port):
    assert [is_there(bus, port, servo) for servo in (1, 2, 3)] == [True, True, False]
    found, result = bus.broadcastPing(port)
    assert (found, result) == ({1: [1060, 46], 2: [1060, 46]}, sdk.COMM_SUCCESS)


@pytest.mark.parametrize(("level", "reads", "writes"), [(0, False, False), (1, True, False), (2, True, True)])
def test_a_status_return_level_decides_what_is_answered(bus, port, level, reads, writes):
    assert write(bus, port, 1, LEVEL, level) == 0
    assert is_there(bus, port, 1)
    assert read(bus, port, 1, LEVEL) == (level if reads else None)
    assert write(bus, port, 1, LED, 1) == (0 if writes else None)
    together = sdk.GroupSyncRead(port, bus, LED, 1)
    together.addParam(1)
    assert (together.txRxPacket() == sdk.COMM_SUCCESS) is reads
    bus.write1ByteTxOnly(port, 1, LEVEL, 2)
    port.pass_time(0.01)
    assert read(bus, port, 1, LED) == 1, "executed, whether answered or not"


@pytest.mark.parametrize(
    ("address", "size", "value", "error"),
    [
        (TORQUE, 1, 7, RANGE), (DRIVE, 1, 255, RANGE), (DRIVE, 1, 2, RANGE), (MODE, 1, 0, RANGE), (ID, 1, 253, RANGE),
        (BAUD, 1, 8, RANGE), (LEVEL, 1, 3, RANGE), (WATCHDOG, 1, 128, RANGE), (MAX, 4, 4096, RANGE),
        (HOMING, 4, 1_044_480, RANGE), (PROFILE, 4, 32768, RANGE), (GOAL, 4, 5000, LIMIT), (GOAL, 4, -1, LIMIT),
        (100, 2, 886, LIMIT), (104, 4, 266, LIMIT), (POSITION, 4, 0, ACCESS), (0, 2, 1, ACCESS), (66, 1, 0, ACCESS),
        (GOAL, 2, 100, LENGTH), (LED, 1, 1, 0), (GOAL, 4, 2000, 0),
    ],
)  # fmt: skip
def test_an_invalid_value_is_refused_with_its_error_and_nothing_is_set(bus, port, address, size, value, error):
    before = read(bus, port, 1, address, size)
    assert write(bus, port, 1, address, value, size) == error
    if error and address != POSITION:
        assert read(bus, port, 1, address, size) == before


def test_settings_are_locked_while_the_torque_is_on(bus, port):
    assert write(bus, port, 1, TORQUE, 1) == 0
    assert [write(bus, port, 1, address, 1) for address in (ID, BAUD, DRIVE, MODE)] == [ACCESS] * 4


def test_registers_in_one_write_are_all_set_or_none(bus, port):
    result, error = bus.writeTxRx(port, 1, PROFILE, 8, [50, 0, 0, 0, 0xD0, 0x07, 0, 0])
    assert (result, error) == (sdk.COMM_SUCCESS, 0)
    assert (read(bus, port, 1, PROFILE, 4), read(bus, port, 1, GOAL, 4)) == (50, 2000)
    result, error = bus.writeTxRx(port, 1, PROFILE, 8, [60, 0, 0, 0, 0x88, 0x13, 0, 0])
    assert (result, error) == (sdk.COMM_SUCCESS, LIMIT)
    assert (read(bus, port, 1, PROFILE, 4), read(bus, port, 1, GOAL, 4)) == (50, 2000)


def test_a_changed_id_changes_the_address(bus, port):
    assert write(bus, port, 2, ID, 7) == 0
    assert [is_there(bus, port, servo) for servo in (2, 7)] == [False, True]
    assert write(bus, port, 7, ID, 2) == 0
    assert is_there(bus, port, 2)


def test_a_secondary_id_is_obeyed_and_not_answered(bus, port):
    assert write(bus, port, 1, 12, 5) == 0
    assert write(bus, port, 5, LED, 1) is None
    assert read(bus, port, 1, LED) == 1


def test_at_another_baud_rate_no_servo_answers(bus, port):
    assert write(bus, port, 2, BAUD, 1) == 0
    assert [is_there(bus, port, servo) for servo in (1, 2)] == [True, False]


def values(group, *servos, address=POSITION):
    return [group.getData(servo, address, 4) if group.isAvailable(servo, address, 4) else None for servo in servos]


def test_sync_reads_return_all_values(bus, port):
    group = sdk.GroupSyncRead(port, bus, POSITION, 4)
    for servo in (1, 2):
        group.addParam(servo)
    assert group.txRxPacket() == sdk.COMM_SUCCESS
    first, second = values(group, 1, 2)
    assert first == pytest.approx(read(bus, port, 1, POSITION, 4), abs=4)
    assert second == pytest.approx(read(bus, port, 2, POSITION, 4), abs=4)


def test_after_a_missing_servo_no_servo_answers_a_sync_read(bus, port):
    group = sdk.GroupSyncRead(port, bus, POSITION, 4)
    for servo in (9, 1, 2):
        group.addParam(servo)
    assert group.txRxPacket() != sdk.COMM_SUCCESS
    assert values(group, 1, 2) == [None, None]


def test_sync_writes_reach_several_servos(bus, port):
    together = sdk.GroupSyncWrite(port, bus, TORQUE, 1)
    for servo, value in ((1, 1), (2, 0)):
        together.addParam(servo, [value])
    assert together.txPacket() == sdk.COMM_SUCCESS
    port.pass_time(0.01)
    assert [read(bus, port, servo, TORQUE) for servo in (1, 2)] == [1, 0]


def test_an_unknown_instruction_is_refused(bus, port):
    assert bus.regWriteTxRx(port, 1, LED, 1, [1]) == (sdk.COMM_SUCCESS, INSTRUCTION)
    assert read(bus, port, 1, LED) == 0


def test_a_reboot_resets_registers_outside_eeprom(bus, port):
    for address, value in ((DRIVE, 4), (TORQUE, 1), (LED, 1), (LEVEL, 2)):
        write(bus, port, 1, address, value)
    assert bus.reboot(port, 1) == (sdk.COMM_SUCCESS, 0)
    assert not is_there(bus, port, 1)
    port.pass_time(0.5)
    assert [read(bus, port, 1, at) for at in (DRIVE, TORQUE, LED, LEVEL)] == [4, 0, 0, 2]


def test_a_tripped_watchdog_refuses_goals_until_it_is_cleared(bus, port):
    write(bus, port, 1, WATCHDOG, 5)
    port.pass_time(0.3)
    assert read(bus, port, 1, WATCHDOG) == 0xFF
    assert write(bus, port, 1, GOAL, 2048, 4) == RANGE
    assert write(bus, port, 1, WATCHDOG, 0) == 0
    assert write(bus, port, 1, GOAL, 2048, 4) == 0


def test_goals_beyond_one_turn_need_the_extended_mode(bus, port):
    assert write(bus, port, 1, MODE, 4) == 0
    assert write(bus, port, 1, TORQUE, 1) == 0
    assert write(bus, port, 1, GOAL, -3000, 4) == 0
    assert write(bus, port, 1, GOAL, 1_048_576, 4) == LIMIT
    port.pass_time(3.0)
    assert read(bus, port, 1, POSITION, 4) - 2**32 == pytest.approx(-3000, abs=4)


def test_a_homing_offset_applies_to_position_and_goal(bus, port):
    before = read(bus, port, 1, POSITION, 4)
    assert write(bus, port, 1, HOMING, 100, 4) == 0
    assert read(bus, port, 1, POSITION, 4) == pytest.approx(before + 100, abs=4)
    write(bus, port, 1, GOAL, before + 100, 4)
    write(bus, port, 1, TORQUE, 1)
    port.pass_time(1.0)
    assert port.arm._servos[0].at(port.t)[0] == pytest.approx(HOME[0], abs=math.radians(0.5)), "it has not moved"
