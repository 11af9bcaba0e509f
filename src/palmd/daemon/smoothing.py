"""The smoother in a process of its own beside the loop: they meet on ZeroMQ, and the loop never waits.

What the process cannot take at once is dropped; a process that has died is started again. It sleeps most of the time,
so that a rig with two cores keeps one for itself.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import zmq

from palmd.events import Event, PadLift, PadSample, PalmSample, RigDescription
from palmd.model import shape_map, smoothing
from palmd.observer.improved import Readings, period
from palmd.observer.improver import Improvement, Improver

log = logging.getLogger(__name__)

BATCH_S = 0.05  # of events that go out in one message
HIGH_WATER = 100  # messages on their way: five seconds
KEPT_EVENTS = 1000  # for a process that does not take them: some four seconds; packing them takes 1 ms
RESTART_S = 10.0  # from one start of the process to the next at least
CLOSE_S = 1.0
SHARE = 0.5  # of one core that the process takes at most, and that only before it has found anything
NICENESS = 10

_KINDS: tuple[type[PadSample] | type[PadLift] | type[PalmSample], ...] = (PadSample, PadLift, PalmSample)


class SmootherProcess:
    """The loop's end; `submit` and `collect` are safe inside the loop, starting the process again takes it 1 ms."""

    def __init__(self, rig: RigDescription) -> None:
        """Start the process; raises OSError when it cannot be."""
        self._rig = json.dumps(asdict(rig))
        self._folder = tempfile.TemporaryDirectory(prefix="palmd-")
        self._address = f"ipc://{Path(self._folder.name) / 'smoother'}"
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.set(zmq.SNDHWM, HIGH_WATER)
        self._socket.set(zmq.LINGER, 0)
        self._socket.bind(self._address)
        self._waiting: list[list[Any]] = []
        self._t_sent = -np.inf
        self.dropped = 0
        self.starts = 0
        self._start()

    def submit(self, t: float, begun: float, events: Sequence[Event]) -> None:
        """Hand the tick's events over, a few ticks' together."""
        self._waiting += [_packed(event) for event in events]
        if t - self._t_sent < BATCH_S:
            return
        self._t_sent = t
        try:
            self._socket.send(msgpack.packb([begun, self._waiting]), zmq.NOBLOCK)
            self._waiting = []
        except zmq.Again:  # it is starting, or stuck, or gone
            lost = len(self._waiting) - KEPT_EVENTS
            if lost > 0:
                del self._waiting[:lost]
                self.dropped += lost
            self._revive()

    def collect(self, t: float) -> Improvement | None:
        """The newest improvement that has come."""
        del t  # it is ready when it is here
        newest: Improvement | None = None
        with contextlib.suppress(zmq.Again):
            while True:
                when, mean, covariance = msgpack.unpackb(self._socket.recv(zmq.NOBLOCK))
                x = np.frombuffer(mean)
                newest = Improvement(when, x, np.frombuffer(covariance).reshape(len(x), -1))
        return newest

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        try:
            self._process.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._socket.close()
        self._context.term()
        self._folder.cleanup()

    def _start(self) -> None:
        self._t_started = time.monotonic()
        self.starts += 1
        command = [sys.executable, "-m", "palmd.daemon.smoother", self._address, str(os.getpid()), self._rig]
        # the linear algebra is of small matrices: more threads would only take the loop's core
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, env=environment)

    def _revive(self) -> None:
        if self._process.poll() is not None and time.monotonic() - self._t_started > RESTART_S:
            log.warning("the smoother ended with status %s: started again", self._process.returncode)
            self._start()


def _packed(event: Event) -> list[Any]:
    kind = next(i for i, each in enumerate(_KINDS) if isinstance(event, each))
    return [kind, *(getattr(event, name) for name in event.__slots__)]


def _unpacked(fields: list[Any]) -> Event:
    event: Event = _KINDS[fields[0]](*fields[1:])
    return event


def serve(address: str, rig: str) -> None:
    """The process's work, for ever: gather readings, smooth, answer; `rig` is the description's fields as JSON."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the loop, which ends this process in its turn
    os.nice(NICENESS)
    context = zmq.Context()
    socket = context.socket(zmq.DEALER)
    socket.set(zmq.LINGER, 0)
    socket.connect(address)
    readings = Readings()
    improver = Improver(RigDescription(**_rig_fields(json.loads(rig))))
    next_one = 0.0
    smoothing.library()
    shape_map.library()
    while True:
        begun, events = msgpack.unpackb(socket.recv())
        readings.add(begun, [_unpacked(event) for event in events])
        if socket.poll(0) or time.monotonic() < next_one:
            continue
        started = time.monotonic()
        improvement = improver.improve(readings.events)
        ended = time.monotonic()
        next_one = max(started + period(readings.seconds), ended + (ended - started) * (1.0 / SHARE - 1.0))
        if improvement is not None:
            socket.send(msgpack.packb([improvement.t, improvement.x.tobytes(), improvement.P.tobytes()]))


def _rig_fields(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()}
