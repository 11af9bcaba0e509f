"""The machine of the simulated daemon: clock, ports, sockets and helpers, all in virtual time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, TypeVar

import zmq

from palmd.daemon.worker import SILENT_S
from palmd.devices.port import DevicePort, PortCounters
from palmd.rig.emulated import EmulatedRig
from palmd.rig.fault_injection import PORTS, PortName
from tools.closed_loop import AtOnce

READING_S = 4e-6
"""Time that a look at the clock takes (s), so that polling loops end."""

RETRY_S = 0.5

T = TypeVar("T")


class Clock:
    """Virtual time (s): the monotonic clock, and the offset of the wall clock."""

    def __init__(self) -> None:
        self.now = 0.0
        self.ahead = 1.7e9

    def __call__(self) -> float:
        """The time; each look advances it a little."""
        self.now += READING_S
        return self.now

    def wall(self) -> float:
        """Unix time (s)."""
        return self.now + self.ahead


class Cable:
    """The line between rig and daemon: bytes held by the adapter, and bytes that the host can read."""

    def __init__(self, every_s: float) -> None:
        """The adapter delivers once in so many seconds."""
        self.every_s = every_s
        self.t_next = 0.0
        self.held = b""
        self.ready = b""
        self.spoil: Callable[[bytes], bytes] | None = None


class Machine:
    """Clock, cables and rig: waiting advances the rig."""

    def __init__(self, rig: EmulatedRig[Any], latency_s: Sequence[float]) -> None:
        """`latency_s`: of each port's adapter."""
        self.rig = rig
        self.clock = Clock()
        self.cables = {port: Cable(each) for port, each in zip(PORTS, latency_s, strict=True)}
        self._step_s = rig.step_s

    def catch_up(self) -> None:
        """Advance the rig to the present."""
        now = self.clock.now
        if now < self.rig.t + self._step_s:
            return
        for port, data in self.rig.advance(now).items():
            self.cables[port].held += data
        for cable in self.cables.values():
            if now < cable.t_next:
                continue
            cable.t_next += cable.every_s * (1 + int((now - cable.t_next) / cable.every_s))
            if cable.held:
                fresh, cable.held = cable.held, b""
                if cable.spoil is not None:
                    fresh, cable.spoil = cable.spoil(fresh), None
                cable.ready += fresh

    def sleep(self, t_end: float, awake: Callable[[], bool]) -> None:
        """Wait until `t_end` (s), or until something wakes the host."""
        clock, cables = self.clock, self.cables.values()
        while not awake():
            t_next = max(min(cable.t_next for cable in cables), self.rig.t + self._step_s) + 1e-9
            if t_next > t_end:
                clock.now = max(clock.now, t_end)
                return
            clock.now = max(clock.now, t_next)
            self.catch_up()


class VirtualPort(DevicePort):
    """The host's end of a cable; see `DevicePort`."""

    def __init__(self, name: PortName, machine: Machine, wrote: Callable[[bytes, float], None]) -> None:
        """`wrote` is called with all written bytes and their time (s)."""
        self.path = name
        self.error: str | None = f"{name} has not been opened yet"
        self.counters = PortCounters()
        self._machine, self._wrote = machine, wrote
        self._cable = machine.cables[name]
        self._open = False
        self._t_retry = -math.inf

    @property
    def is_open(self) -> bool:
        """Whether it can be read and written."""
        return self._open

    @property
    def waiting(self) -> bool:
        """Whether there are bytes to read, or the port has vanished."""
        return self._open and (bool(self._cable.ready) or self._machine.rig.unplugged(self.path))

    def fileno(self) -> int:
        """It has no file descriptor."""
        raise ValueError(self.path)

    def poll_open(self, t: float) -> bool:
        """Open it if a retry is due."""
        if not self._open and t >= self._t_retry:
            self._t_retry = t + RETRY_S
            if self._machine.rig.unplugged(self.path):
                self.error = f"no such port {self.path}"
            else:
                self._open, self.error = True, None
                self.counters.opens += 1
                self._cable.held = self._cable.ready = b""  # opening flushes
                self._machine.rig.opened(self.path)
        return self._open

    def read(self) -> bytes:
        """The bytes that have arrived."""
        if self._gone():
            return b""
        data, self._cable.ready = self._cable.ready, b""
        self.counters.bytes_read += len(data)
        return data

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._machine.catch_up()
        if self._gone():
            self.counters.bytes_dropped += len(data)
            return
        self.counters.bytes_written += len(data)
        self._wrote(data, self._machine.clock.now)
        self._machine.rig.receive(self.path, data)

    def update_counters(self) -> None:
        """There are no kernel counters."""

    def close(self) -> None:
        """Close it."""
        self._open = False

    def _gone(self) -> bool:
        if self._open and self._machine.rig.unplugged(self.path):
            self._open = False
            self.error = f"{self.path} was lost"
            self.counters.losses += 1
            self._cable.held = self._cable.ready = b""
        return not self._open


class VirtualWaiter:
    """Waits for ports as `PortWaiter` does."""

    def __init__(self, machine: Machine, ports: Sequence[VirtualPort]) -> None:
        self._machine, self._ports = machine, ports

    def wait(self, t_deadline: float) -> list[DevicePort]:
        """The ports with data."""
        self._machine.catch_up()
        self._machine.sleep(t_deadline, lambda: any(port.waiting for port in self._ports))
        return [port for port in self._ports if port.waiting]


# ------------------------------------------------------------------------------------------------------ sockets


@dataclass(slots=True)
class Frame:
    """As `zmq.Frame`, as far as the bus uses it."""

    bytes: bytes
    more: bool

    def get(self, _option: str) -> str:
        """The client's identity."""
        return "virtual"


class VirtualSocket:
    """As a `zmq.Socket` without options and address."""

    def setsockopt(self, *_: Any) -> None:
        """No options."""

    def bind(self, _address: str) -> None:
        """No address."""

    def close(self) -> None:
        """Nothing to close."""


class CommandSocket(VirtualSocket):
    """The daemon's command socket: messages of clients, and answers."""

    def __init__(self, received: Callable[[int, bytes], None], answered: Callable[[int, bytes], None]) -> None:
        """`received` and `answered` are called with every message when it is received, and with every answer."""
        self.waiting: deque[tuple[int, bytes]] = deque()
        self._received, self._answered = received, answered
        self._frames: deque[Frame] = deque()

    def recv(self, _flags: int, *, copy: bool) -> Frame:  # noqa: ARG002
        """The next frame of a message; raises zmq.Again."""
        if not self._frames:
            if not self.waiting:
                raise zmq.Again
            client, payload = self.waiting.popleft()
            self._received(client, payload)
            self._frames += [Frame(b"%d" % client, True), Frame(b"", True), Frame(payload, False)]
        return self._frames.popleft()

    def send_multipart(self, frames: Sequence[bytes], _flags: int) -> None:
        """Send an answer."""
        self._answered(int(frames[0]), frames[-1])


class Publisher(VirtualSocket):
    """The daemon's publisher."""

    def __init__(self, published: Callable[[Sequence[bytes]], None]) -> None:
        """`published` is called with every message's frames."""
        self._published = published

    def send_multipart(self, frames: Sequence[bytes], _flags: int) -> None:
        """Publish a message."""
        self._published(frames)


class Sockets:
    """A ZeroMQ context with these two sockets."""

    def __init__(self, publisher: Publisher, commands: CommandSocket) -> None:
        self._found = {zmq.PUB: publisher, zmq.ROUTER: commands}

    def socket(self, kind: int) -> Any:
        """The socket of this type."""
        return self._found[zmq.SocketType(kind)]

    def destroy(self) -> None:
        """Nothing to end."""


# ------------------------------------------------------------------------------------------------------ helpers


class LateFuture(Future[T]):
    """Done when its time has come."""

    def __init__(self, clock: Clock, t_done: float) -> None:
        super().__init__()
        self._clock, self._t_done = clock, t_done

    def done(self) -> bool:
        """Whether it is done."""
        return self._clock.now >= self._t_done


class Aside(AtOnce):
    """Work beside the loop with a configurable duration: it is done at once, and the result is available later."""

    def __init__(self, clock: Clock, takes_s: Callable[[], float]) -> None:
        """`takes_s`: duration of work that is submitted now (s)."""
        self._clock, self._takes_s = clock, takes_s

    def new_future(self) -> Future[Any]:
        """A future for work that is submitted now."""
        return LateFuture(self._clock, self._clock.now + self._takes_s())


class VirtualSmoother:
    """A smoother's process, as far as its faults matter: its signs of life have a configurable delay."""

    def __init__(self, late_s: Callable[[], float]) -> None:
        """`late_s`: present delay (s) of its signs of life."""
        self._late_s = late_s

    def conditions(self, _t: float) -> Iterator[str]:
        """The codes of the active faults."""
        if self._late_s() > SILENT_S:
            yield "smoother-silent"
