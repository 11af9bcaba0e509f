"""Whether the servos on a bus are what palmd needs: numbered checks, each a question or a few to one servo or to all.

A check is a function of a `ServoTalk`, which asks and waits; it returns what it saw, or raises `ServoDeviationError`
with what it saw instead and what mends it. Those that turn the torque on say so (`moves`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from palmd.devices import dynamixel as dxl
from palmd.devices.servoaxis import CENTRE, Axis
from palmd.devices.servobus import Packet, Registers, ServoMake
from palmd.devices.servohost import ServoHost, cycle_period
from palmd.devices.servoscripts import ANSWER_S

SOON_S = 0.008
"""An answer later than this is one that an adapter has held back."""

WARM_C = 60
STEP_COUNTS = 46  # 4°


class ServoDeviationError(Exception):
    """Something is not as it ought to be: what was seen, and what mends it."""

    def __init__(self, seen: str, mend: str = "") -> None:
        super().__init__(seen)
        self.seen, self.mend = seen, mend


class ServoTalk(Protocol):
    """A bus to ask."""

    baud: int

    def ask(self, packet: bytes, patience_s: float = ANSWER_S, answers: int = 1) -> list[tuple[Packet, float]]:
        """Send, and wait for so many answers; each with how long it took (s)."""

    def wait(self, seconds: float) -> None:
        """Say nothing for so long."""


@dataclass(frozen=True, slots=True)
class ServoCheck:
    """One check: its clause, whether it turns the torque on, and what does it; of each servo, or (`all`) of the bus.

    needs_refusals, needs_watchdog: only of makes that have these.
    """

    clause: str
    examine: Callable[[ServoTalk, Axis, Sequence[Axis]], str]
    moves: bool = False
    of_bus: bool = False
    needs_refusals: bool = False
    needs_watchdog: bool = False

    def concerns(self, make: ServoMake) -> bool:
        """Whether servos of that make can be asked for it."""
        return not ((self.needs_refusals and not make.refusals) or (self.needs_watchdog and make.watchdog is None))


@dataclass(frozen=True, slots=True)
class ServoResult:
    """What came of a check; `servo` is the palm's number, 0 for the bus."""

    number: int
    servo: int
    clause: str
    outcome: Literal["passed", "failed"]
    seen: str
    mend: str = ""


def _answer(talk: ServoTalk, packet: bytes, axis: Axis) -> Packet:
    answers = talk.ask(packet)
    make = axis.make
    if not answers and talk.ask(make.ping(axis.id)):
        raise ServoDeviationError(
            f"id {axis.id} answers PING, but not this: its status return level (register {make.status_level.address})"
            f" is below {make.all_answered}",
            "palmd run sets it when it opens the bus",
        )
    if not answers:
        raise ServoDeviationError(
            f"id {axis.id} does not answer at {talk.baud} bit/s",
            f"check supply and cable; set id {axis.id} and that speed with the maker's tool, one servo at a time",
        )
    return answers[0][0]


def _registers(talk: ServoTalk, axis: Axis) -> Registers:
    make = axis.make
    answer = _answer(talk, make.read(axis.id, 0, make.table_bytes), axis)
    if len(answer.parameters) != make.table_bytes:
        raise ServoDeviationError(
            f"{len(answer.parameters)} of {make.table_bytes} bytes of its table", "update its firmware"
        )
    return Registers(0, answer.parameters)


def _answers(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    _answer(talk, axis.make.ping(axis.id), axis)
    spans = sorted(span for _ in range(10) for _, span in talk.ask(axis.make.ping(axis.id)))
    if not spans or spans[len(spans) // 2] > SOON_S:
        took = f"{spans[len(spans) // 2] * 1e3:.1f} ms" if spans else "for ever"
        raise ServoDeviationError(
            f"an answer takes {took}",
            "sudo palmd install sets the adapter's latency timer to 1 ms (or setserial PORT low_latency);"
            " use a direct USB port",
        )
    return f"id {axis.id} answers in {spans[len(spans) // 2] * 1e3:.1f} ms"


def _is_known(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    registers = _registers(talk, axis)
    make = axis.make
    model = registers[make.model]
    if model in make.unfit:
        unfit = make.unfit[model]
        raise ServoDeviationError(f"an {unfit.what}, {unfit.why}", unfit.mend)
    if model not in make.models:
        raise ServoDeviationError(f"model {model}", f"use one of {', '.join(make.models.values())}")
    return f"{make.models[model]}, firmware {registers[make.firmware]}"


def _is_alone(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    answers = talk.ask(axis.make.ping(axis.id), answers=2)
    if len(answers) > 1:
        raise ServoDeviationError(
            f"two servos have id {axis.id}", "give one another id, with the other one off the bus"
        )
    return f"one servo has id {axis.id}"


def _is_well(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    registers = _registers(talk, axis)
    make = axis.make
    volts, degrees = registers[make.voltage] * 0.1, registers[make.temperature]
    error, (least, most) = registers[make.hardware_error], make.supply_v
    if error:
        raise ServoDeviationError(f"hardware error {error:#04x}", "palmd ctl reset starts it anew")
    if not least <= volts <= most:
        raise ServoDeviationError(f"{volts:.1f} V", f"a supply of {least:g} to {most:g} V, with short cables")
    if degrees > WARM_C:
        raise ServoDeviationError(f"{degrees} °C", "let it cool down; lighter palms")
    return f"{volts:.1f} V, {degrees} °C, no hardware error"


def _is_set(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    registers = _registers(talk, axis)
    wrong = [(reg.address, registers[reg], value) for reg, value in axis.settings() if registers[reg] != value]
    if wrong:
        said = ", ".join(f"register {address} is {found}, {value} is needed" for address, found, value in wrong)
        raise ServoDeviationError(said, "palmd run sets it when it opens the bus")
    return f"all {len(axis.settings())} settings, limits {axis.low} to {axis.high}"


def _is_where_it_may_be(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    at = _registers(talk, axis)[axis.make.position]
    if not axis.low <= at <= axis.high:
        raise ServoDeviationError(
            f"it counts {at}, outside {axis.low} to {axis.high}",
            f"turn its palm inside by hand; is it mounted so that {CENTRE} is at centre_deg?",
        )
    return f"counts {at}"


def _in_turn(talk: ServoTalk, _axis: Axis, axes: Sequence[Axis]) -> str:
    ids = [axis.id for axis in axes]
    make = axes[0].make
    period_s = cycle_period(talk.baud, len(axes), make)
    spans = []
    for _ in range(20):
        answers = talk.ask(make.sync_read(*make.cycle, ids), answers=len(ids))
        if [packet.servo for packet, _ in answers] != ids:
            raise ServoDeviationError(
                f"answers of {[packet.servo for packet, _ in answers]} to a Sync Read of {ids}", "check cables and ids"
            )
        spans.append(answers[-1][1])
    if (median := sorted(spans)[len(spans) // 2]) > period_s:
        raise ServoDeviationError(
            f"{median * 1e3:.1f} ms for both, and a cycle is {period_s * 1e3:.0f} ms",
            "sudo palmd install for the latency timer; return delay 0; a faster bus",
        )
    return f"both in {median * 1e3:.1f} ms of {period_s * 1e3:.0f} ms"


def _ignores_damage(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    damaged = bytearray(axis.make.ping(axis.id))
    damaged[-1] ^= 0x10
    if any(not packet.error for packet, _ in talk.ask(bytes(damaged))):
        raise ServoDeviationError("it answers a packet with a wrong checksum", "update its firmware")
    _answer(talk, axis.make.ping(axis.id), axis)
    return "a damaged packet is not obeyed, the next one is"


def _refuses(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    """Without torque; the goal stays what it was."""
    answer = _answer(talk, dxl.write(axis.id, dxl.GOAL, axis.high + 1), axis)
    if not answer.error & ~dxl.ALERT:
        raise ServoDeviationError("it takes a goal beyond its limit", "update its firmware; palmd run sets the limits")
    return f"a goal beyond its limit: {dxl.ERRORS.get(answer.error & 0x7F, 'refused')}"


def _watches(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    """Without torque."""
    _answer(talk, dxl.write(axis.id, dxl.WATCHDOG, 2), axis)
    talk.wait(0.100)
    registers = _registers(talk, axis)
    refused = _answer(talk, dxl.write(axis.id, dxl.GOAL, registers[dxl.GOAL]), axis).error
    _answer(talk, dxl.write(axis.id, dxl.WATCHDOG, 0), axis)
    if registers[dxl.WATCHDOG] != -1:
        raise ServoDeviationError(
            f"after 100 ms of silence register 98 is {registers[dxl.WATCHDOG]}, not -1", "update its firmware"
        )
    if not refused & ~dxl.ALERT:
        raise ServoDeviationError("it takes goals with its watchdog tripped", "update its firmware")
    if _registers(talk, axis)[dxl.WATCHDOG] != 0:
        raise ServoDeviationError("a tripped watchdog cannot be cleared", "switch its power off and on")
    return "trips, refuses goals, and is cleared"


def _holds(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    """With torque, where it stands."""
    make = axis.make
    at = _registers(talk, axis)[axis.make.position]
    _answer(talk, make.write(axis.id, make.goal, at), axis)
    _answer(talk, make.write(axis.id, make.torque, 1), axis)
    try:
        locked = _answer(talk, make.write(axis.id, make.return_delay, 0), axis).error
        talk.wait(0.2)
        now = _registers(talk, axis)[make.position]
    finally:
        talk.ask(make.write(axis.id, make.torque, 0))
    if make.refusals and not locked & make.refusals:
        raise ServoDeviationError("its settings can be written while the torque is on", "update its firmware")
    if abs(now - at) > STEP_COUNTS:
        raise ServoDeviationError(
            f"it goes from {at} to {now} when the torque comes on", "take the load off; see homing offset"
        )
    return f"stands within {abs(now - at)} counts" + (", settings locked" if make.refusals else "")


def _stops_by_itself(talk: ServoTalk, axis: Axis, _axes: Sequence[Axis]) -> str:
    """With torque: sent on a way of 4° in half a second, then left alone."""
    at = _registers(talk, axis)[axis.make.position]
    goal = at + STEP_COUNTS if at + STEP_COUNTS <= axis.high else at - STEP_COUNTS
    for register, value in (
        (dxl.PROFILE_ACCELERATION, 0),
        (dxl.PROFILE_VELOCITY, 500),
        (dxl.GOAL, at),
        (dxl.TORQUE, 1),
    ):
        _answer(talk, dxl.write(axis.id, register, value), axis)
    try:
        _answer(talk, dxl.write(axis.id, dxl.WATCHDOG, 5), axis)
        _answer(talk, dxl.write(axis.id, dxl.GOAL, goal), axis)
        talk.wait(0.250)
        first = _registers(talk, axis)
        talk.wait(0.150)
        later = _registers(talk, axis)
    finally:
        for register in (dxl.WATCHDOG, dxl.TORQUE):
            talk.ask(dxl.write(axis.id, register, 0))
    if first[dxl.WATCHDOG] != -1:
        raise ServoDeviationError("its watchdog has not tripped within 250 ms", "update its firmware")
    if abs(later[dxl.POSITION] - first[dxl.POSITION]) > 3 or abs(later[dxl.POSITION] - goal) < STEP_COUNTS // 4:
        raise ServoDeviationError(
            f"it went on after its watchdog tripped, from {first[dxl.POSITION]} to {later[dxl.POSITION]}",
            "do not use it: it would not stop when palmd's machine dies",
        )
    return f"stood at {later[dxl.POSITION]} on the way from {at} to {goal}"


CHECKS: tuple[ServoCheck, ...] = (
    ServoCheck("it answers, and soon", _answers),
    ServoCheck("it is a servo that palmd knows", _is_known),
    ServoCheck("no other servo has its id", _is_alone),
    ServoCheck("supply and temperature are right, no hardware error", _is_well),
    ServoCheck("its settings are those that palmd needs", _is_set),
    ServoCheck("it stands inside its range", _is_where_it_may_be),
    ServoCheck("both answer a Sync Read in turn, within a cycle", _in_turn, of_bus=True),
    ServoCheck("a damaged packet is not obeyed", _ignores_damage),
    ServoCheck("a goal beyond its limit is refused", _refuses, needs_refusals=True),
    ServoCheck("its watchdog trips after a silence, and is cleared", _watches, needs_watchdog=True),
    ServoCheck("it stands where it is when the torque comes on, and refuses settings then", _holds, moves=True),
    ServoCheck("it stops by itself when nobody speaks any more", _stops_by_itself, moves=True, needs_watchdog=True),
)


def examine(talk: ServoTalk, axes: Sequence[Axis], checks: Sequence[ServoCheck] = CHECKS) -> Iterator[ServoResult]:
    """The checks, of each servo in turn; one that does not answer is asked no more."""
    mute: set[int] = set()
    for check in checks:
        for axis in axes[:1] if check.of_bus else axes:
            if axis.id in mute or (check.of_bus and mute) or not check.concerns(axis.make):
                continue
            result = _examined(talk, check, axis, axes)
            if check is CHECKS[0] and result.outcome == "failed" and "does not answer" in result.seen:
                mute.add(axis.id)
            yield result


def _examined(talk: ServoTalk, check: ServoCheck, axis: Axis, axes: Sequence[Axis]) -> ServoResult:
    number, servo = CHECKS.index(check) + 1, 0 if check.of_bus else axis.number
    try:
        return ServoResult(number, servo, check.clause, "passed", check.examine(talk, axis, axes))
    except ServoDeviationError as deviation:
        return ServoResult(number, servo, check.clause, "failed", deviation.seen, deviation.mend)


class PortTalk:
    """A `ServoTalk` on a real port, which is opened and shut by `with`; OSError where it cannot be."""

    def __init__(self, host: ServoHost, baud: int, port: str) -> None:
        from palmd.devices.port import Port

        self.baud = baud
        self.axes = host.axes
        self._port = Port("arm", port, baud)

    def __enter__(self) -> PortTalk:
        if not self._port.poll_open(time.monotonic()):
            raise OSError(self._port.error)
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()

    def ask(self, packet: bytes, patience_s: float = ANSWER_S, answers: int = 1) -> list[tuple[Packet, float]]:
        """See `ServoTalk`."""
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
        """See `ServoTalk`."""
        time.sleep(seconds)
