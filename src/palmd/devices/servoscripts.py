"""What takes several questions to servos: setting them up, arming, resetting, standing down.

Each is a script, a generator that yields what to ask and is given the answers; the host asks, again if need be.
A USB adapter may hold each answer for 16 ms. So what all servos need at once goes out as Sync Writes with one Sync Read
behind them, which shows whether they were taken: a Sync Write itself is never answered.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Mapping, Sequence
from dataclasses import dataclass

from palmd.devices.servoaxis import Axis
from palmd.devices.servobus import Packet, Register, Registers

ANSWER_S = 0.040
"""A USB adapter may hold an answer for 16 ms; twice that is no answer."""

TRIES = 4
REBOOT_S = 0.9
WATCHDOG_UNITS = 5
WATCHDOG_S = WATCHDOG_UNITS * 0.020
"""Without an instruction for so long a servo stops by itself."""


@dataclass(frozen=True, slots=True)
class Ask:
    """A question that each of these servos answers, with so many bytes.

    refusals: bits of an answer's error that say that it was not carried out.
    """

    packet: bytes
    servos: tuple[int, ...]
    size: int
    refusals: int
    tries: int = TRIES

    def fits(self, packet: Packet) -> bool:
        """Whether a packet may be one of the answers, a refusal included."""
        return packet.servo in self.servos and (
            len(packet.parameters) == self.size or bool(packet.error & self.refusals)
        )


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
        if not axis.make.ping_bytes:
            (answer,) = yield _read(axis, axis.make.model.address, axis.make.model.size)
        models[axis.id] = int.from_bytes(answer.parameters[:2], "little") if len(answer.parameters) >= 2 else 0
    changed = 0
    for axis in axes:
        make = axis.make
        _check_model(axis, models[axis.id])
        (whole,) = yield _read(axis, 0, make.table_bytes)
        registers = Registers(0, whole.parameters)
        wrong = [(register, value) for register, value in axis.settings() if registers.get(register) != value]
        locked = any(register.address < make.settings_end for register, _ in wrong)
        if (locked or axis.id in let_go) and registers.get(make.torque):
            yield _write(axis, make.torque, 0)
        if locked and make.unlock is not None:
            yield _write(axis, make.unlock, 0)
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
        if locked and make.unlock is not None:
            yield _write(axis, make.unlock, 1)
        if make.watchdog is not None:
            yield _write(axis, make.watchdog, 0)
    return changed


def _check_model(axis: Axis, model: int) -> None:
    make = axis.make
    if model in make.unfit:
        unfit = make.unfit[model]
        raise SetUpError(f"servo {axis.number} is an {unfit.what}, {unfit.why}: {unfit.mend}")
    if model not in make.models:
        raise SetUpError(
            f"servo {axis.number} says it is of model {model}, which palmd does not know; it knows"
            f" {', '.join(make.models.values())}"
        )


def prepare(axes: Sequence[Axis], profile_ms: int) -> Generator[Ask, Answers, dict[int, Registers]]:
    """Has every servo's profile set and its watchdog off; what they have. Raises ServoRefusedError."""
    profile = axes[0].make.profile(profile_ms)
    return (
        yield from _set(
            axes, [*_watchdog(axes, 0), *((register, dict.fromkeys(_ids(axes), value)) for register, value in profile)]
        )
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
        here = at[axis.make.goal] if at[axis.make.torque] else at[axis.make.position]
        goals[axis.id] = min(max(here, axis.low), axis.high)
    make = axes[0].make
    held = yield from _set(axes, [(make.goal, goals), (make.torque, dict.fromkeys(_ids(axes), 1))])
    watched = _watchdog(axes, WATCHDOG_UNITS)
    awake = (yield from _set(axes, watched)) if watched else held
    return goals, awake


def stand_down(axes: Sequence[Axis]) -> Generator[Ask, Answers, None]:
    """Has no watchdog wait for instructions any more. Raises ServoRefusedError."""
    if watched := _watchdog(axes, 0):
        yield from _set(axes, watched)


def let_go(axes: Sequence[Axis]) -> Generator[Ask, Answers, None]:
    """Turns the torque of these servos off. Raises ServoRefusedError."""
    if axes:
        yield from _set(axes, [*_watchdog(axes, 0), (axes[0].make.torque, dict.fromkeys(_ids(axes), 0))])


def restart(axes: Sequence[Axis]) -> Generator[Ask, Answers, None]:
    """Has these servos start anew, and waits until they answer."""
    for axis in axes:
        yield Ask(axis.make.restart(axis.id), (axis.id,), 0, axis.make.refusals)
    for axis in axes:
        yield _ping(axis, tries=round(REBOOT_S / ANSWER_S))


def _set(
    axes: Sequence[Axis], settings: Sequence[tuple[Register, Mapping[int, int]]]
) -> Generator[Ask, Answers, dict[int, Registers]]:
    """Has registers set, each to a value by id, in this order; what all servos have then.

    Again where one was not taken, for a Sync Write may have been damaged on the line. Raises ServoRefusedError.
    """
    ids, make = _ids(axes), axes[0].make
    address, size = make.look
    packet = b"".join(make.sync_write(*each) for each in settings) + make.sync_read(address, size, ids)
    for _ in range(TRIES):
        answers = yield Ask(packet, ids, size, make.refusals)
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


def _ids(axes: Sequence[Axis]) -> tuple[int, ...]:
    return tuple(axis.id for axis in axes)


def _watchdog(axes: Sequence[Axis], units: int) -> list[tuple[Register, Mapping[int, int]]]:
    """Sets every watchdog, where there are any."""
    watchdog = axes[0].make.watchdog
    return [] if watchdog is None else [(watchdog, dict.fromkeys(_ids(axes), units))]


def _ping(axis: Axis, tries: int) -> Ask:
    """Has it answer everything, and asks who it is: with a status return level of 0 it answers this alone."""
    make = axis.make
    packet = make.sync_write(make.status_level, {axis.id: make.all_answered}) + make.ping(axis.id)
    return Ask(packet, (axis.id,), make.ping_bytes, make.refusals, tries)


def _read(axis: Axis, address: int, size: int) -> Ask:
    return Ask(axis.make.read(axis.id, address, size), (axis.id,), size, axis.make.refusals)


def _write(axis: Axis, register: Register, value: int) -> Ask:
    return Ask(axis.make.write(axis.id, register, value), (axis.id,), 0, axis.make.refusals)
