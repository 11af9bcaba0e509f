"""Findings about a rig's servos for `palmd doctor`: checks that change nothing.

A check is a function of a `ServoTalk` and a servo; it returns what it observed, or raises `ServoDeviationError` with
the deviation and how to fix it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Self

from palmd.config.arms import DynamixelConfig, FeetechConfig
from palmd.devices.actuator import make_actuator
from palmd.devices.port import Port, PortUnavailableError
from palmd.devices.servobus import CENTRE, Axis, Packet, Registers
from palmd.devices.servohost import ServoHost, cycle_period
from palmd.devices.servoscripts import ANSWER_S
from palmd.doctor.finding import Finding

MAX_LATENCY_S = 0.008
"""Latency (s) above which an adapter has delayed the answer."""

MAX_TEMPERATURE_C = 60


class ServoDeviationError(Exception):
    """A check failed: what was observed, and how to fix it."""

    def __init__(self, seen: str, fix: str = "") -> None:
        super().__init__(seen)
        self.seen, self.fix = seen, fix


class NoAnswerError(ServoDeviationError):
    """A servo does not answer at all."""


class ServoTalk:
    """Access to the servos at a port, a context manager; raises PortUnavailableError."""

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


def answer(talk: ServoTalk, packet: bytes, axis: Axis) -> Packet:
    """The servo's answer to a packet; raises ServoDeviationError, NoAnswerError."""
    received = talk.ask(packet)
    make = axis.make
    if not received and talk.ask(make.ping(axis.id)):
        raise ServoDeviationError(
            f"id {axis.id} answers PING, but not this instruction: its status return level (register"
            f" {make.status_level.address}) is below {make.all_answered}",
            "palmd run sets it when it opens the bus",
        )
    if not received:
        raise NoAnswerError(
            f"id {axis.id} does not answer at {talk.baud} bit/s",
            f"check supply and cable; set id {axis.id} and that speed with the maker's tool, one servo at a time",
        )
    return received[0][0]


def read_registers(talk: ServoTalk, axis: Axis) -> Registers:
    """The servo's whole table; raises ServoDeviationError, NoAnswerError."""
    make = axis.make
    table = answer(talk, make.read(axis.id, 0, make.table_bytes), axis).parameters
    if len(table) != make.table_bytes:
        raise ServoDeviationError(
            f"it answers {len(table)} of {make.table_bytes} bytes of its table", "update its firmware"
        )
    return Registers(0, table)


def answers(talk: ServoTalk, axis: Axis) -> str:
    """Whether it answers in time."""
    answer(talk, axis.make.ping(axis.id), axis)
    spans = sorted(span for _ in range(10) for _, span in talk.ask(axis.make.ping(axis.id)))
    if not spans or spans[len(spans) // 2] > MAX_LATENCY_S:
        took = f"{spans[len(spans) // 2] * 1e3:.1f} ms" if spans else "longer than the timeout"
        raise ServoDeviationError(
            f"an answer takes {took}",
            "sudo palmd install sets the adapter's latency timer to 1 ms (or setserial PORT low_latency);"
            " use a direct USB port",
        )
    return f"id {axis.id} answers in {spans[len(spans) // 2] * 1e3:.1f} ms"


def is_known(talk: ServoTalk, axis: Axis) -> str:
    """Whether palmd supports its model."""
    registers = read_registers(talk, axis)
    make = axis.make
    model = registers[make.model]
    if model in make.unsupported:
        model_info = make.unsupported[model]
        raise ServoDeviationError(f"an {model_info.what}, {model_info.reason}", model_info.fix)
    if model not in make.models:
        raise ServoDeviationError(f"model {model}", f"use one of {', '.join(make.models.values())}")
    return f"{make.models[model]}, firmware {registers[make.firmware]}"


def has_unique_id(talk: ServoTalk, axis: Axis) -> str:
    """Whether no other servo has its id."""
    received = talk.ask(axis.make.ping(axis.id), answers=2)
    if len(received) > 1:
        raise ServoDeviationError(
            f"two servos have id {axis.id}", "change the id of one of them while the other is disconnected"
        )
    return f"one servo has id {axis.id}"


def is_healthy(talk: ServoTalk, axis: Axis) -> str:
    """Whether supply and temperature are in range, without a hardware error."""
    registers = read_registers(talk, axis)
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


def has_settings(talk: ServoTalk, axis: Axis) -> str:
    """Whether its settings are those that palmd needs."""
    registers = read_registers(talk, axis)
    wrong = [(reg.address, registers[reg], value) for reg, value in axis.settings() if registers[reg] != value]
    if wrong:
        differences = ", ".join(f"register {address} is {found}, {value} is needed" for address, found, value in wrong)
        raise ServoDeviationError(differences, "palmd run sets it when it opens the bus")
    return f"all {len(axis.settings())} settings, limits {axis.low} to {axis.high}"


def is_in_range(talk: ServoTalk, axis: Axis) -> str:
    """Whether its position is inside its range."""
    position = read_registers(talk, axis)[axis.make.position]
    if not axis.low <= position <= axis.high:
        raise ServoDeviationError(
            f"it counts {position}, outside {axis.low} to {axis.high}",
            f"turn its palm inside by hand; check that it is mounted with {CENTRE} at centre_deg",
        )
    return f"counts {position}"


def answers_in_order(talk: ServoTalk, first: Axis) -> str:
    """Whether all answer a Sync Read in order, within a cycle."""
    ids = [axis.id for axis in talk.axes]
    make = first.make
    period_s = cycle_period(talk.baud, len(ids), make)
    spans = []
    for _ in range(20):
        received = talk.ask(make.sync_read(*make.cycle_span, ids), answers=len(ids))
        if [packet.servo for packet, _ in received] != ids:
            raise ServoDeviationError(
                f"answers of {[packet.servo for packet, _ in received]} to a Sync Read of {ids}", "check cables and ids"
            )
        spans.append(received[-1][1])
    if (median := sorted(spans)[len(spans) // 2]) > period_s:
        raise ServoDeviationError(
            f"both answers take {median * 1e3:.1f} ms, longer than the cycle of {period_s * 1e3:.0f} ms",
            "set the latency timer with sudo palmd install; set return delay 0; use a faster bus",
        )
    return f"both in {median * 1e3:.1f} ms of {period_s * 1e3:.0f} ms"


Check = Callable[[ServoTalk, Axis], str]
CHECKS: tuple[Check, ...] = (answers, is_known, has_unique_id, is_healthy, has_settings, is_in_range)
"""Of each servo, in this order."""


def findings(arm: DynamixelConfig | FeetechConfig) -> Iterator[Finding]:
    """Yield a finding for each check of each servo, and of their bus."""
    try:
        with open_talk(arm) as talk:
            silent: set[int] = set()
            for check in CHECKS:
                for axis in talk.axes:
                    if axis.id not in silent:
                        yield _finding(f"servo {axis.number}", check, talk, axis, silent)
            if not silent:
                yield _finding("servos", answers_in_order, talk, talk.axes[0], silent)
    except PortUnavailableError as error:
        yield Finding("servos", "missing", str(error))


def _finding(what: str, check: Check, talk: ServoTalk, axis: Axis, silent: set[int]) -> Finding:
    try:
        return Finding(what, "ok", check(talk, axis))
    except ServoDeviationError as deviation:
        if isinstance(deviation, NoAnswerError):
            silent.add(axis.id)
        return Finding(what, "missing", deviation.seen, deviation.fix)


def open_talk(arm: DynamixelConfig | FeetechConfig) -> ServoTalk:
    """Access to the configured servos."""
    host = make_actuator(arm)
    assert isinstance(host, ServoHost)
    return ServoTalk(arm.port, arm.baud, host.axes)
