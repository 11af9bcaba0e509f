"""What takes several questions to servos: setting them up, arming, resetting, standing down.

Each is a script, a generator that yields what to ask and is given the answer; the host asks, again if need be.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass

from palmd.devices import dynamixel as dxl
from palmd.devices.dynamixel import Packet, Register, Registers
from palmd.devices.servoaxis import Axis

ANSWER_S = 0.040
"""A USB adapter may hold an answer for 16 ms; twice that is no answer."""

TRIES = 4
REBOOT_S = 0.9
WATCHDOG_UNITS = 5
WATCHDOG_S = WATCHDOG_UNITS * 0.020
"""Without an instruction for so long a servo stops by itself."""

LOOK_SPAN = (dxl.TORQUE.address, dxl.TEMPERATURE.end - dxl.TORQUE.address)

MODELS: Mapping[int, str] = {
    1020: "XM430-W350",
    1030: "XM430-W210",
    1060: "XL430-W250",
    1070: "XC430-W150",
    1080: "XC430-W240",
}
"""Servos that are known to stop when their watchdog trips, and to have the registers that are used here."""

TRIPS_WITHOUT_STOPPING: Mapping[int, str] = {
    1190: "XL330-M077",
    1200: "XL330-M288",
    1220: "XC330-T181",
    1230: "XC330-T288",
}


@dataclass(frozen=True, slots=True)
class Ask:
    """A question to one servo, whose answer has so many bytes."""

    packet: bytes
    servo: int
    size: int
    tries: int = TRIES

    def fits(self, packet: Packet) -> bool:
        """Whether a packet may be the answer, a refusal included."""
        return packet.servo == self.servo and (len(packet.parameters) == self.size or bool(packet.error & ~dxl.ALERT))


class SetUpError(Exception):
    """A servo cannot be used as it is; says why and what to do."""


class ServoRefusedError(Exception):
    """A servo does not take what it needs before it may move; says which."""


def set_up(axes: Sequence[Axis]) -> Generator[Ask, Packet, int]:
    """Finds every servo, compares its settings and sets what differs; how many that were. Raises SetUpError."""
    models = {}
    for axis in axes:
        answer = yield _ping(axis, tries=1)
        models[axis.id] = int.from_bytes(answer.parameters[:2], "little") if len(answer.parameters) >= 3 else 0
    changed = 0
    for axis in axes:
        _check_model(axis, models[axis.id])
        whole = yield _read(axis, 0, dxl.TABLE_BYTES)
        registers = Registers(0, whole.parameters)
        wrong = [(register, value) for register, value in axis.settings() if registers.get(register) != value]
        if any(register.address < dxl.EEPROM_END for register, _ in wrong) and registers.get(dxl.TORQUE):
            yield _write(axis, dxl.TORQUE, 0)
        for register, value in wrong:
            changed += 1
            yield _write(axis, register, value)
            answer = yield _read(axis, register.address, register.size)
            found = Registers(register.address, answer.parameters).get(register)
            if found != value:
                raise SetUpError(
                    f"servo {axis.number} keeps {found} in register {register.address}, {value} is needed: switch"
                    " its power off and on, and see that no other program writes to it"
                )
        yield _write(axis, dxl.WATCHDOG, 0)
    return changed


def _check_model(axis: Axis, model: int) -> None:
    if model in TRIPS_WITHOUT_STOPPING:
        raise SetUpError(
            f"servo {axis.number} is an {TRIPS_WITHOUT_STOPPING[model]}, whose watchdog trips without stopping it:"
            " use a servo of the 430 size"
        )
    if model not in MODELS:
        raise SetUpError(
            f"servo {axis.number} says it is of model {model}, which palmd does not know; it knows"
            f" {', '.join(MODELS.values())}"
        )


def arm(axes: Sequence[Axis], profile_ms: int) -> Generator[Ask, Packet, tuple[float, ...]]:
    """Has every servo hold where it stands, its watchdog awake; the directions (rad). Raises ServoRefusedError."""
    directions = []
    for axis in axes:
        profile = ((dxl.PROFILE_ACCELERATION, 0), (dxl.PROFILE_VELOCITY, profile_ms))
        for register, value in ((dxl.WATCHDOG, 0), *profile):
            yield _write(axis, register, value)
        answer = yield _read(axis, *LOOK_SPAN)
        registers = Registers(LOOK_SPAN[0], answer.parameters)
        here = registers[dxl.GOAL] if registers[dxl.TORQUE] else registers[dxl.POSITION]
        here = min(max(here, axis.low), axis.high)
        yield _write(axis, dxl.GOAL, here)
        yield _write(axis, dxl.TORQUE, 1)
        answer = yield _read(axis, *LOOK_SPAN)
        registers = Registers(LOOK_SPAN[0], answer.parameters)
        for register, value in ((dxl.GOAL, here), (dxl.TORQUE, 1), (dxl.PROFILE_VELOCITY, profile_ms)):
            if registers[register] != value:
                raise ServoRefusedError(
                    f"start refused: servo {axis.number} has {registers[register]} in register {register.address},"
                    f" {value} was sent"
                )
        directions.append(axis.direction(here))
    for axis in axes:
        yield _write(axis, dxl.WATCHDOG, WATCHDOG_UNITS)
    return tuple(directions)


def stand_down(axes: Sequence[Axis]) -> Generator[Ask, Packet, None]:
    """Has no watchdog wait for instructions any more."""
    for axis in axes:
        yield _write(axis, dxl.WATCHDOG, 0)


def restart(axes: Sequence[Axis]) -> Generator[Ask, Packet, None]:
    """Has these servos start anew, and waits until they answer."""
    for axis in axes:
        yield Ask(dxl.reboot(axis.id), axis.id, 0)
    for axis in axes:
        yield _ping(axis, tries=round(REBOOT_S / ANSWER_S))


def _ping(axis: Axis, tries: int) -> Ask:
    return Ask(dxl.ping(axis.id), axis.id, 3, tries)


def _read(axis: Axis, address: int, size: int) -> Ask:
    return Ask(dxl.read(axis.id, address, size), axis.id, size)


def _write(axis: Axis, register: Register, value: int) -> Ask:
    return Ask(dxl.write(axis.id, register, value), axis.id, 0)
