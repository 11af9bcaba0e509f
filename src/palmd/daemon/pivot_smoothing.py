"""The smoother of a pivoting grasp in a process of its own beside the loop.

The process loads SciPy, the loop does not. What it cannot take at once is kept for some seconds, then dropped.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import msgpack
import numpy as np

from palmd.daemon.smoothing import BATCH_S, HIGH_WATER, KEPT_EVENTS, NICENESS, packed, unpacked
from palmd.daemon.worker import WorkerProcess, give_back_memory, meet
from palmd.events import Event
from palmd.system.description import PadSensor
from palmd.system.pivot import PivotAnswer, PivotRig

SHARE = 0.5  # of one core that the process takes at most


class PivotSmootherProcess:
    """The loop's end; `submit` and `collect` are safe inside the loop."""

    def __init__(self, rig: PivotRig) -> None:
        """Start the process; raises OSError when it cannot be."""
        self._process = WorkerProcess("smoother", __name__, json.dumps(asdict(rig)), high_water=HIGH_WATER)
        self._waiting: list[list[Any]] = []
        self._t_sent = -np.inf
        self.dropped = 0

    @property
    def starts(self) -> int:
        """How often the process has been started."""
        return self._process.starts

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Hand the tick's events over, a few ticks' together."""
        self._waiting += [packed(event) for event in events]
        if t - self._t_sent < BATCH_S:
            return
        self._t_sent = t
        if self._process.send(msgpack.packb(self._waiting)):
            self._waiting = []
            return
        lost = len(self._waiting) - KEPT_EVENTS
        if lost > 0:
            del self._waiting[:lost]
            self.dropped += lost

    def collect(self, t: float) -> PivotAnswer | None:
        """The newest answer that has come."""
        del t  # it is ready when it is here
        newest: PivotAnswer | None = None
        for message in self._process.received():
            when, claimed, reason, psi, *arrays = msgpack.unpackb(message)
            p, covariance, h_sd, touched = map(np.frombuffer, arrays)
            newest = PivotAnswer(when, claimed, reason, psi, p, covariance.reshape(len(p), len(p)), h_sd, touched)
        return newest

    def close(self) -> None:
        """End the process."""
        self._process.close()


def rig_of(fields: dict[str, Any]) -> PivotRig:
    """The rig of its description's fields."""
    return PivotRig(**fields | {"pad": PadSensor(**fields["pad"])})


def serve(address: str, rig: str) -> None:
    """The process's work, for ever: gather readings, reconstruct, answer; `rig` is the rig's fields as JSON."""
    from palmd.observer.pivot.growing import PERIOD_S, GrowingSmoother

    smoother = GrowingSmoother(rig_of(json.loads(rig)))
    next_one = 0.0
    with meet(address, NICENESS) as socket:
        while True:
            smoother.add([unpacked(event) for event in msgpack.unpackb(socket.recv())])
            if socket.poll(0) or time.monotonic() < next_one:
                continue
            started = time.monotonic()
            answer = smoother.answer()
            ended = time.monotonic()
            next_one = max(started + PERIOD_S, ended + (ended - started) * (1.0 / SHARE - 1.0))
            if answer is not None:
                a = answer
                arrays = (each.tobytes() for each in (a.p, a.covariance, a.h_sd, a.touched))
                socket.send(msgpack.packb([a.t, a.claimed, a.reason, a.psi, *arrays]))
            give_back_memory()
