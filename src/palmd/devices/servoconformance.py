"""Conformance checks of the servos on a bus: numbered checks, each of a few requests to one servo or to all.

A check is a function of a `ServoTalk`, which sends requests and waits; tests substitute one with emulated servos. It
returns what it observed, or raises
`ServoDeviationError` with the deviation and how to fix it. Checks that turn the torque on have `moves` set.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, Self

from palmd.devices import dynamixel as dxl
from palmd.devices.port import Port, PortUnavailableError
from palmd.devices.servobus import CENTRE, Axis, Packet, Register, Registers, ServoMake
from palmd.devices.servohost import cycle_period
from palmd.devices.servoscripts import ANSWER_S

MAX_LATENCY_S = 0.008
"""Latency (s) above which an adapter has delayed the answer."""

MAX_TEMPERATURE_C = 60
STEP_COUNTS = 46  # 4°


class ServoDeviationError(Exception):
    """A check failed: what was observed, and how to fix it."""

    def __init__(self, seen: str, fix: str = "") -> None:
        super().__init__(seen)
        self.seen, self.fix = seen, fix


class NoAnswerError(ServoDeviationError):
    """A servo does not answer at all."""


class ServoTalk:
    """Access to the servos at a port for checks, a context manager; raises PortUnavailableError."""

    def __init__(self, port: str, baud: int, axes: Sequence[Axis]) -> None:
        self.baud, self.axes = baud, axes
        self._port = Port("arm", port, baud)

    def __enter__(self) -> Self:
        if not self._port.poll_open(time.monotonic()):
            raise PortUnavailableError(self._port.error)
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()

    def ask(self, packet: bytes, patience_s: float = ANSWER_S, answers: int = 1) -> list[tuple[Packet, float]]:
        """Send a packet and wait for `answers` answers; return each with its latency (s)."""
        reader = self.axes[0].make.reader(self.baud)
        while self._port.read():
            pass
        t_sent = time.monotonic()
        self._port.write(packet)
        found: list[tuple[Packet, float]] = []
        while len(found) < answers and time.monotonic() < t_sent + patience_s:
            time.sleep(2e-4)
            t = time.monotonic()
            found += [(each, t - t_sent) for each in reader.feed(self._port.read(), t) if each.is_status]
        return found

    def wait(self, seconds: float) -> None:
        """Send nothing for `seconds`."""
        time.sleep(seconds)


@dataclass(frozen=True, slots=True)
class ServoCheck:
    """One check: its clause, the function, whether it turns the torque on; of each servo, or (`of_bus`) of the bus.

    needs_refusals, needs_watchdog: applies only to makes that have these.
    """

    clause: str
    examine: Callable[[ServoTalk, Axis], str]
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


def _answer(talk: ServoTalk, packet: bytes, axis: Axis) -> Packet:
    answers = talk.ask(packet)
    make = axis.make
    if not answers and talk.ask(make.ping(axis.id)):
        raise ServoDeviationError(
            f"id {axis.id} answers PING, but not this instruction: its status return level (register"
            f" {make.status_level.address}) is below {make.all_answered}",
            "palmd run sets it when it opens the bus",
        )
    if not answers:
        raise NoAnswerError(
            f"id {axis.id} does not answer at {talk.baud} bit/s",
            f"check supply and cable; set id {axis.id} and that speed with the maker's tool, one servo at a time",
        )
    return answers[0][0]


def _write(talk: ServoTalk, axis: Axis, register: Register, value: int) -> Packet:
    return _answer(talk, axis.make.write(axis.id, register, value), axis)


def _registers(talk: ServoTalk, axis: Axis) -> Registers:
    make = axis.make
    answer = _answer(talk, make.read(axis.id, 0, make.table_bytes), axis)
    if len(answer.parameters) != make.table_bytes:
        raise ServoDeviationError(
            f"it answers {len(answer.parameters)} of {make.table_bytes} bytes of its table", "update its firmware"
        )
    return Registers(0, answer.parameters)


def _answers(talk: ServoTalk, axis: Axis) -> str:
    _answer(talk, axis.make.ping(axis.id), axis)
    spans = sorted(span for _ in range(10) for _, span in talk.ask(axis.make.ping(axis.id)))
    if not spans or spans[len(spans) // 2] > MAX_LATENCY_S:
        took = f"{spans[len(spans) // 2] * 1e3:.1f} ms" if spans else "longer than the timeout"
        raise ServoDeviationError(
            f"an answer takes {took}",
            "sudo palmd install sets the adapter's latency timer to 1 ms (or setserial PORT low_latency);"
            " use a direct USB port",
        )
    return f"id {axis.id} answers in {spans[len(spans) // 2] * 1e3:.1f} ms"


def _is_known(talk: ServoTalk, axis: Axis) -> str:
    registers = _registers(talk, axis)
    make = axis.make
    model = registers[make.model]
    if model in make.unsupported:
        model_info = make.unsupported[model]
        raise ServoDeviationError(f"an {model_info.what}, {model_info.reason}", model_info.fix)
    if model not in make.models:
        raise ServoDeviationError(f"model {model}", f"use one of {', '.join(make.models.values())}")
    return f"{make.models[model]}, firmware {registers[make.firmware]}"


def _has_unique_id(talk: ServoTalk, axis: Axis) -> str:
    answers = talk.ask(axis.make.ping(axis.id), answers=2)
    if len(answers) > 1:
        raise ServoDeviationError(
            f"two servos have id {axis.id}", "change the id of one of them while the other is disconnected"
        )
    return f"one servo has id {axis.id}"


def _is_healthy(talk: ServoTalk, axis: Axis) -> str:
    registers = _registers(talk, axis)
    make = axis.make
    volts, degrees = registers[make.voltage] * 0.1, registers[make.temperature]
    error, (least, most) = registers[make.hardware_error], make.supply_v
    if error:
        raise ServoDeviationError(f"hardware error {error:#04x}", "palmd ctl reset restarts it")
    if not least <= volts <= most:
        raise ServoDeviationError(f"{volts:.1f} V", f"use a supply of {least:g} to {most:g} V, with short cables")
    if degrees > MAX_TEMPERATURE_C:
        raise ServoDeviationError(f"{degrees} °C", "let it cool down; use lighter palms")
    return f"{volts:.1f} V, {degrees} °C, no hardware error"


def _has_settings(talk: ServoTalk, axis: Axis) -> str:
    registers = _registers(talk, axis)
    wrong = [(reg.address, registers[reg], value) for reg, value in axis.settings() if registers[reg] != value]
    if wrong:
        differences = ", ".join(f"register {address} is {found}, {value} is needed" for address, found, value in wrong)
        raise ServoDeviationError(differences, "palmd run sets it when it opens the bus")
    return f"all {len(axis.settings())} settings, limits {axis.low} to {axis.high}"


def _is_in_range(talk: ServoTalk, axis: Axis) -> str:
    position = _registers(talk, axis)[axis.make.position]
    if not axis.low <= position <= axis.high:
        raise ServoDeviationError(
            f"it counts {position}, outside {axis.low} to {axis.high}",
            f"turn its palm inside by hand; check that it is mounted with {CENTRE} at centre_deg",
        )
    return f"counts {position}"


def _answers_in_order(talk: ServoTalk, first: Axis) -> str:
    ids = [axis.id for axis in talk.axes]
    make = first.make
    period_s = cycle_period(talk.baud, len(ids), make)
    spans = []
    for _ in range(20):
        answers = talk.ask(make.sync_read(*make.cycle_span, ids), answers=len(ids))
        if [packet.servo for packet, _ in answers] != ids:
            raise ServoDeviationError(
                f"answers of {[packet.servo for packet, _ in answers]} to a Sync Read of {ids}", "check cables and ids"
            )
        spans.append(answers[-1][1])
    if (median := sorted(spans)[len(spans) // 2]) > period_s:
        raise ServoDeviationError(
            f"both answers take {median * 1e3:.1f} ms, longer than the cycle of {period_s * 1e3:.0f} ms",
            "set the latency timer with sudo palmd install; set return delay 0; use a faster bus",
        )
    return f"both in {median * 1e3:.1f} ms of {period_s * 1e3:.0f} ms"


def _ignores_damage(talk: ServoTalk, axis: Axis) -> str:
    damaged = bytearray(axis.make.ping(axis.id))
    damaged[-1] ^= 0x10
    if any(not packet.error for packet, _ in talk.ask(bytes(damaged))):
        raise ServoDeviationError("it answers a packet with a wrong checksum", "update its firmware")
    _answer(talk, axis.make.ping(axis.id), axis)
    return "a damaged packet is ignored, the next one is answered"


def _refuses(talk: ServoTalk, axis: Axis) -> str:
    """Without torque; the goal stays unchanged."""
    answer = _write(talk, axis, dxl.GOAL, axis.high + 1)
    if not answer.error & ~dxl.ALERT:
        raise ServoDeviationError(
            "it accepts a goal beyond its limit", "update its firmware; palmd run sets the limits"
        )
    return f"a goal beyond its limit: {dxl.ERRORS.get(answer.error & 0x7F, 'refused')}"


def _watchdog_trips(talk: ServoTalk, axis: Axis) -> str:
    """Without torque."""
    _write(talk, axis, dxl.WATCHDOG, 2)
    talk.wait(0.100)
    registers = _registers(talk, axis)
    refused = _write(talk, axis, dxl.GOAL, registers[dxl.GOAL]).error
    _write(talk, axis, dxl.WATCHDOG, 0)
    if registers[dxl.WATCHDOG] != -1:
        raise ServoDeviationError(
            f"after 100 ms of silence register 98 is {registers[dxl.WATCHDOG]}, not -1", "update its firmware"
        )
    if not refused & ~dxl.ALERT:
        raise ServoDeviationError("it accepts goals while its watchdog is tripped", "update its firmware")
    if _registers(talk, axis)[dxl.WATCHDOG] != 0:
        raise ServoDeviationError("a tripped watchdog cannot be cleared", "switch its power off and on")
    return "trips, refuses goals, and can be cleared"


def _holds(talk: ServoTalk, axis: Axis) -> str:
    """With torque, at its position."""
    make = axis.make
    position = _registers(talk, axis)[axis.make.position]
    _write(talk, axis, make.goal, position)
    _write(talk, axis, make.torque, 1)
    try:
        locked = _write(talk, axis, make.return_delay, 0).error
        talk.wait(0.2)
        now = _registers(talk, axis)[make.position]
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
    position = _registers(talk, axis)[axis.make.position]
    goal = position + STEP_COUNTS if position + STEP_COUNTS <= axis.high else position - STEP_COUNTS
    profile = (dxl.PROFILE_ACCELERATION, 0), (dxl.PROFILE_VELOCITY, 500)
    for register, value in (*profile, (dxl.GOAL, position), (dxl.TORQUE, 1)):
        _write(talk, axis, register, value)
    try:
        _write(talk, axis, dxl.WATCHDOG, 5)
        _write(talk, axis, dxl.GOAL, goal)
        talk.wait(0.250)
        first = _registers(talk, axis)
        talk.wait(0.150)
        later = _registers(talk, axis)
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
    ServoCheck("it answers within 8 ms", _answers),
    ServoCheck("palmd supports its model", _is_known),
    ServoCheck("no other servo has its id", _has_unique_id),
    ServoCheck("supply and temperature are in range, no hardware error", _is_healthy),
    ServoCheck("its settings are those that palmd needs", _has_settings),
    ServoCheck("its position is inside its range", _is_in_range),
    ServoCheck("both answer a Sync Read in order, within a cycle", _answers_in_order, of_bus=True),
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
