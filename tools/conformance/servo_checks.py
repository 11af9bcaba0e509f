"""Conformance checks of the servos on a bus: numbered checks, each of a few requests to one servo or to all.

A check is a function of a `ServoTalk`, which sends requests and waits; tests substitute one with emulated servos. The
first seven are those of `palmd doctor`. Checks that turn the torque on have `moves` set.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from palmd.devices import dynamixel as dxl
from palmd.devices.servobus import Axis, Packet, Register, ServoMake
from palmd.doctor.servos import (
    Check,
    NoAnswerError,
    ServoDeviationError,
    ServoTalk,
    answer,
    answers,
    answers_in_order,
    has_settings,
    has_unique_id,
    is_healthy,
    is_in_range,
    is_known,
    read_registers,
)

STEP_COUNTS = 46  # 4°


@dataclass(frozen=True, slots=True)
class ServoCheck:
    """One check: its clause, the function, whether it turns the torque on; of each servo, or (`of_bus`) of the bus.

    needs_refusals, needs_watchdog: applies only to makes that have these.
    """

    clause: str
    examine: Check
    moves: bool = False
    of_bus: bool = False
    needs_refusals: bool = False
    needs_watchdog: bool = False

    def applies_to(self, make: ServoMake) -> bool:
        """Whether the check applies to servos of that make."""
        return not ((self.needs_refusals and not make.refusals) or (self.needs_watchdog and make.watchdog is None))


@dataclass(frozen=True, slots=True)
class ServoResult:
    """Result of a check; `servo` is the palm's number, 0 for the bus."""

    number: int
    servo: int
    clause: str
    outcome: Literal["passed", "failed"]
    seen: str
    fix: str = ""


def _write(talk: ServoTalk, axis: Axis, register: Register, value: int) -> Packet:
    return answer(talk, axis.make.write(axis.id, register, value), axis)


def _ignores_damage(talk: ServoTalk, axis: Axis) -> str:
    damaged = bytearray(axis.make.ping(axis.id))
    damaged[-1] ^= 0x10
    if any(not packet.error for packet, _ in talk.ask(bytes(damaged))):
        raise ServoDeviationError("it answers a packet with a wrong checksum", "update its firmware")
    answer(talk, axis.make.ping(axis.id), axis)
    return "a damaged packet is ignored, the next one is answered"


def _refuses(talk: ServoTalk, axis: Axis) -> str:
    """Without torque; the goal stays unchanged."""
    refusal = _write(talk, axis, dxl.GOAL, axis.high + 1)
    if not refusal.error & ~dxl.ALERT:
        raise ServoDeviationError(
            "it accepts a goal beyond its limit", "update its firmware; palmd run sets the limits"
        )
    return f"a goal beyond its limit: {dxl.ERRORS.get(refusal.error & 0x7F, 'refused')}"


def _watchdog_trips(talk: ServoTalk, axis: Axis) -> str:
    """Without torque."""
    _write(talk, axis, dxl.WATCHDOG, 2)
    talk.wait(0.100)
    registers = read_registers(talk, axis)
    refused = _write(talk, axis, dxl.GOAL, registers[dxl.GOAL]).error
    _write(talk, axis, dxl.WATCHDOG, 0)
    if registers[dxl.WATCHDOG] != -1:
        raise ServoDeviationError(
            f"after 100 ms of silence register 98 is {registers[dxl.WATCHDOG]}, not -1", "update its firmware"
        )
    if not refused & ~dxl.ALERT:
        raise ServoDeviationError("it accepts goals while its watchdog is tripped", "update its firmware")
    if read_registers(talk, axis)[dxl.WATCHDOG] != 0:
        raise ServoDeviationError("a tripped watchdog cannot be cleared", "switch its power off and on")
    return "trips, refuses goals, and can be cleared"


def _holds(talk: ServoTalk, axis: Axis) -> str:
    """With torque, at its position."""
    make = axis.make
    position = read_registers(talk, axis)[axis.make.position]
    _write(talk, axis, make.goal, position)
    _write(talk, axis, make.torque, 1)
    try:
        locked = _write(talk, axis, make.return_delay, 0).error
        talk.wait(0.2)
        now = read_registers(talk, axis)[make.position]
    finally:
        talk.ask(make.write(axis.id, make.torque, 0))
    if make.refusals and not locked & make.refusals:
        raise ServoDeviationError("its settings are not locked while the torque is on", "update its firmware")
    if abs(now - position) > STEP_COUNTS:
        raise ServoDeviationError(
            f"it moves from {position} to {now} when the torque is turned on",
            "remove the load; check the homing offset",
        )
    return f"holds within {abs(now - position)} counts" + (", settings locked" if make.refusals else "")


def _stops_without_instructions(talk: ServoTalk, axis: Axis) -> str:
    """With torque: start a move of 4° in half a second, then send nothing."""
    position = read_registers(talk, axis)[axis.make.position]
    goal = position + STEP_COUNTS if position + STEP_COUNTS <= axis.high else position - STEP_COUNTS
    profile = (dxl.PROFILE_ACCELERATION, 0), (dxl.PROFILE_VELOCITY, 500)
    for register, value in (*profile, (dxl.GOAL, position), (dxl.TORQUE, 1)):
        _write(talk, axis, register, value)
    try:
        _write(talk, axis, dxl.WATCHDOG, 5)
        _write(talk, axis, dxl.GOAL, goal)
        talk.wait(0.250)
        first = read_registers(talk, axis)
        talk.wait(0.150)
        later = read_registers(talk, axis)
    finally:
        for register in (dxl.WATCHDOG, dxl.TORQUE):
            talk.ask(axis.make.write(axis.id, register, 0))
    if first[dxl.WATCHDOG] != -1:
        raise ServoDeviationError("its watchdog has not tripped within 250 ms", "update its firmware")
    if abs(later[dxl.POSITION] - first[dxl.POSITION]) > 3 or abs(later[dxl.POSITION] - goal) < STEP_COUNTS // 4:
        raise ServoDeviationError(
            f"it moved on after its watchdog tripped, from {first[dxl.POSITION]} to {later[dxl.POSITION]}",
            "do not use it: it would not stop if palmd's machine fails",
        )
    return f"stopped at {later[dxl.POSITION]} on the way from {position} to {goal}"


CHECKS: tuple[ServoCheck, ...] = (
    ServoCheck("it answers within 8 ms", answers),
    ServoCheck("palmd supports its model", is_known),
    ServoCheck("no other servo has its id", has_unique_id),
    ServoCheck("supply and temperature are in range, no hardware error", is_healthy),
    ServoCheck("its settings are those that palmd needs", has_settings),
    ServoCheck("its position is inside its range", is_in_range),
    ServoCheck("both answer a Sync Read in order, within a cycle", answers_in_order, of_bus=True),
    ServoCheck("a damaged packet is ignored", _ignores_damage),
    ServoCheck("a goal beyond its limit is refused", _refuses, needs_refusals=True),
    ServoCheck("its watchdog trips after a silence, and can be cleared", _watchdog_trips, needs_watchdog=True),
    ServoCheck("it holds its position when the torque is turned on, and locks its settings", _holds, moves=True),
    ServoCheck("it stops when instructions cease", _stops_without_instructions, moves=True, needs_watchdog=True),
)


def examine(talk: ServoTalk, checks: Sequence[ServoCheck] = CHECKS) -> Iterator[ServoResult]:
    """Run the checks for each servo; a servo that does not answer the first one is skipped from then on."""
    mute: set[int] = set()
    for check in checks:
        number = CHECKS.index(check) + 1
        for axis in talk.axes[:1] if check.of_bus else talk.axes:
            if axis.id in mute or (check.of_bus and mute) or not check.applies_to(axis.make):
                continue
            servo = 0 if check.of_bus else axis.number
            try:
                yield ServoResult(number, servo, check.clause, "passed", check.examine(talk, axis))
            except ServoDeviationError as deviation:
                if check is CHECKS[0] and isinstance(deviation, NoAnswerError):
                    mute.add(axis.id)
                yield ServoResult(number, servo, check.clause, "failed", deviation.seen, deviation.fix)
