"""What takes several questions to servos: setting them up, arming, resetting, standing down.

Each is a script, a generator that yields what to ask and is given the answers; the host asks, again if need be.
A USB adapter may hold each answer for 16 ms. So what all servos need at once goes out as Sync Writes with one Sync Read
behind them, which shows whether they were taken: a Sync Write itself is never answered.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Mapping, Sequence
from dataclasses import dataclass

from palmd.devices import dynamixel as dxl
from palmd.devices.dynamixel import Packet, Register, Registers
from palmd.devices.servoaxis import ALL_ANSWERED, Axis

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
    """A question that each of these servos answers, with so many bytes."""

    packet: bytes
    servos: tuple[int, ...]
    size: int
    tries: int = TRIES

    def fits(self, packet: Packet) -> bool:
        """Whether a packet may be one of the answers, a refusal included."""
        return packet.servo in self.servos and (len(packet.parameters) == self.size or bool(packet.error & ~dxl.ALERT))


Answers = Sequence[Packet]
"""One of each servo that was asked, in that order."""


class SetUpError(Exception):
    """A servo cannot be used as it is; says why and what to do."""


class ServoRefusedError(Exception):
    """A servo does not take what it needs before it may move; says which."""


def set_up(axes: Sequence[Axis], let_go: Collection[int] = ()) -> Generator[Ask, Answers, int]:
    """Finds every servo, compares its settings and sets what differs; how many that were. Raises SetUpError.

    let_go: ids of servos whose torque goes off, for they were turned on by an `arm` that came to nothing.
    """
    models = {}
    for axis in axes:
        (answer,) = yield _ping(axis, tries=1)
        models[axis.id] = int.from_bytes(answer.parameters[:2], "little") if len(answer.parameters) >= 3 else 0
    changed = 0
    for axis in axes:
        _check_model(axis, models[axis.id])
        (whole,) = yield _read(axis, 0, dxl.TABLE_BYTES)
        registers = Registers(0, whole.parameters)
        wrong = [(register, value) for register, value in axis.settings() if registers.get(register) != value]
        locked = any(register.address < dxl.EEPROM_END for register, _ in wrong)
        if (locked or axis.id in let_go) and registers.get(dxl.TORQUE):
            yield _write(axis, dxl.TORQUE, 0)
        for register, value in wrong:
            changed += 1
            yield _write(axis, register, value)
            (answer,) = yield _read(axis, register.address, register.size)
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


def prepare(axes: Sequence[Axis], profile_ms: int) -> Generator[Ask, Answers, dict[int, Registers]]:
    """Has every servo's profile set and its watchdog off; what they have. Raises ServoRefusedError."""
    off = {axis.id: 0 for axis in axes}
    profile = {axis.id: profile_ms for axis in axes}
    return (
        yield from _set(axes, [(dxl.WATCHDOG, off), (dxl.PROFILE_ACCELERATION, off), (dxl.PROFILE_VELOCITY, profile)])
    )


def hold(
    axes: Sequence[Axis], found: Mapping[int, Registers]
) -> Generator[Ask, Answers, tuple[dict[int, int], dict[int, Registers]]]:
    """Has every servo hold where it stands, its watchdog awake: the goals by id, and what they have then.

    found: what they had before. Raises ServoRefusedError.
    """
    goals = {}
    for axis in axes:
        at = found[axis.id]
        here = at[dxl.GOAL] if at[dxl.TORQUE] else at[dxl.POSITION]
        goals[axis.id] = min(max(here, axis.low), axis.high)
    yield from _set(axes, [(dxl.GOAL, goals), (dxl.TORQUE, {axis.id: 1 for axis in axes})])
    awake = yield from _set(axes, [(dxl.WATCHDOG, {axis.id: WATCHDOG_UNITS for axis in axes})])
    return goals, awake


def stand_down(axes: Sequence[Axis]) -> Generator[Ask, Answers, None]:
    """Has no watchdog wait for instructions any more. Raises ServoRefusedError."""
    yield from _set(axes, [(dxl.WATCHDOG, {axis.id: 0 for axis in axes})])


def let_go(axes: Sequence[Axis]) -> Generator[Ask, Answers, None]:
    """Turns the torque of these servos off. Raises ServoRefusedError."""
    if axes:
        off = {axis.id: 0 for axis in axes}
        yield from _set(axes, [(dxl.WATCHDOG, off), (dxl.TORQUE, off)])


def restart(axes: Sequence[Axis]) -> Generator[Ask, Answers, None]:
    """Has these servos start anew, and waits until they answer."""
    for axis in axes:
        yield Ask(dxl.reboot(axis.id), (axis.id,), 0)
    for axis in axes:
        yield _ping(axis, tries=round(REBOOT_S / ANSWER_S))


def _set(
    axes: Sequence[Axis], settings: Sequence[tuple[Register, Mapping[int, int]]]
) -> Generator[Ask, Answers, dict[int, Registers]]:
    """Has registers set, each to a value by id, in this order; what all servos have then.

    Again where one was not taken, for a Sync Write may have been damaged on the line. Raises ServoRefusedError.
    """
    ids = tuple(axis.id for axis in axes)
    address, size = LOOK_SPAN
    packet = b"".join(dxl.sync_write(*each) for each in settings) + dxl.sync_read(address, size, ids)
    for _ in range(TRIES):
        answers = yield Ask(packet, ids, size)
        found = {answer.servo: Registers(address, answer.parameters) for answer in answers}
        wrong = [
            f"servo {axis.number} has {found[axis.id].get(register)} in register {register.address},"
            f" {values[axis.id]} was sent"
            for axis in axes
            for register, values in settings
            if found[axis.id].get(register) != values[axis.id]
        ]
        if not wrong:
            return found
    raise ServoRefusedError(wrong[0])


def _ping(axis: Axis, tries: int) -> Ask:
    """Has it answer everything, and asks who it is: with a status return level of 0 it answers this alone."""
    return Ask(dxl.sync_write(dxl.STATUS_LEVEL, {axis.id: ALL_ANSWERED}) + dxl.ping(axis.id), (axis.id,), 3, tries)


def _read(axis: Axis, address: int, size: int) -> Ask:
    return Ask(dxl.read(axis.id, address, size), (axis.id,), size)


def _write(axis: Axis, register: Register, value: int) -> Ask:
    return Ask(dxl.write(axis.id, register, value), (axis.id,), 0)
