"""Sequences of several servo requests: set-up, arming, disarming, reset.

Each is a script: a generator that yields requests and receives the answers; the host sends the requests and repeats
them if necessary. A USB adapter may delay each answer by 16 ms. So writes to all servos are Sync Writes followed by one
Sync Read, which verifies them: a Sync Write itself is never answered.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Mapping, Sequence
from dataclasses import dataclass

from palmd.devices.servobus import Axis, Packet, Register, Registers

ANSWER_S = 0.040
"""Timeout of an answer (s); a USB adapter may delay it by 16 ms."""

TRIES = 4
REBOOT_S = 0.9
WATCHDOG_UNITS = 5
WATCHDOG_S = WATCHDOG_UNITS * 0.020
"""Time without an instruction (s) after which a servo's watchdog stops it."""


@dataclass(frozen=True, slots=True)
class ServoRequest:
    """A request that each of these servos answers with `size` parameter bytes.

    refusals: bits of an answer's error that report that it was not executed.
    """

    packet: bytes
    servos: tuple[int, ...]
    size: int
    refusals: int
    tries: int = TRIES

    def fits(self, packet: Packet) -> bool:
        """Whether a packet can be one of the answers, refusals included."""
        return packet.servo in self.servos and (
            len(packet.parameters) == self.size or bool(packet.error & self.refusals)
        )


Answers = Sequence[Packet]
"""One answer of each servo, in the order of the request."""


class SetUpError(Exception):
    """A servo cannot be used; the text has reason and what to do."""


class ServoRefusedError(Exception):
    """A servo does not accept a setting that it needs before it may move; the text names it."""


def set_up(axes: Sequence[Axis], release: Collection[int] = ()) -> Generator[ServoRequest, Answers, int]:
    """Find every servo, compare its settings and write those that differ; return their number. Raises SetUpError.

    release: ids of servos whose torque is turned off, since an `arm` that failed had turned it on.
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
        if (locked or axis.id in release) and registers.get(make.torque):
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
                    " its power off and on, and check that no other program writes to it"
                )
        if locked and make.unlock is not None:
            yield _write(axis, make.unlock, 1)
        if make.watchdog is not None:
            yield _write(axis, make.watchdog, 0)
    return changed


def _check_model(axis: Axis, model: int) -> None:
    make = axis.make
    if model in make.unsupported:
        model_info = make.unsupported[model]
        raise SetUpError(f"servo {axis.number} is an {model_info.what}, {model_info.reason}: {model_info.fix}")
    if model not in make.models:
        raise SetUpError(
            f"servo {axis.number} reports model {model}, which palmd does not support; supported are"
            f" {', '.join(make.models.values())}"
        )


def prepare(axes: Sequence[Axis], profile_ms: int) -> Generator[ServoRequest, Answers, dict[int, Registers]]:
    """Set all profiles and turn the watchdogs off; return the registers read back. Raises ServoRefusedError."""
    profile = axes[0].make.profile(profile_ms)
    return (
        yield from _set(
            axes, [*_watchdog(axes, 0), *((register, dict.fromkeys(_ids(axes), value)) for register, value in profile)]
        )
    )


def hold(
    axes: Sequence[Axis], found: Mapping[int, Registers]
) -> Generator[ServoRequest, Answers, tuple[dict[int, int], dict[int, Registers]]]:
    """Make every servo hold its position with its watchdog on; return goals by id and the registers read back.

    found: registers read before. Raises ServoRefusedError.
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


def stop_watchdogs(axes: Sequence[Axis]) -> Generator[ServoRequest, Answers, None]:
    """Turn the watchdogs off. Raises ServoRefusedError."""
    if watched := _watchdog(axes, 0):
        yield from _set(axes, watched)


def torque_off(axes: Sequence[Axis]) -> Generator[ServoRequest, Answers, None]:
    """Turn off the torque of these servos. Raises ServoRefusedError."""
    if axes:
        yield from _set(axes, [*_watchdog(axes, 0), (axes[0].make.torque, dict.fromkeys(_ids(axes), 0))])


def restart(axes: Sequence[Axis]) -> Generator[ServoRequest, Answers, None]:
    """Restart these servos and wait until they answer."""
    for axis in axes:
        yield ServoRequest(axis.make.restart(axis.id), (axis.id,), 0, axis.make.refusals)
    for axis in axes:
        yield _ping(axis, tries=round(REBOOT_S / ANSWER_S))


def _set(
    axes: Sequence[Axis], settings: Sequence[tuple[Register, Mapping[int, int]]]
) -> Generator[ServoRequest, Answers, dict[int, Registers]]:
    """Write registers, each with a value by id, in this order; return the registers read back.

    Repeated if a value was not accepted, since a Sync Write may have been damaged. Raises ServoRefusedError.
    """
    ids, make = _ids(axes), axes[0].make
    address, size = make.status_span
    packet = b"".join(make.sync_write(*each) for each in settings) + make.sync_read(address, size, ids)
    for _ in range(TRIES):
        answers = yield ServoRequest(packet, ids, size, make.refusals)
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
    """Return the write of all watchdogs; empty if the make has none."""
    watchdog = axes[0].make.watchdog
    return [] if watchdog is None else [(watchdog, dict.fromkeys(_ids(axes), units))]


def _ping(axis: Axis, tries: int) -> ServoRequest:
    """Set the status return level so that the servo answers everything, and ping it, which it answers at any level."""
    make = axis.make
    packet = make.sync_write(make.status_level, {axis.id: make.all_answered}) + make.ping(axis.id)
    return ServoRequest(packet, (axis.id,), make.ping_bytes, make.refusals, tries)


def _read(axis: Axis, address: int, size: int) -> ServoRequest:
    return ServoRequest(axis.make.read(axis.id, address, size), (axis.id,), size, axis.make.refusals)


def _write(axis: Axis, register: Register, value: int) -> ServoRequest:
    return ServoRequest(axis.make.write(axis.id, register, value), (axis.id,), 0, axis.make.refusals)
