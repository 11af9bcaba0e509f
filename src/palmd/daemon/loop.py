"""The 100 Hz loop: one thread, one grid of deadlines, ports and sockets at its rim.

Until the tick's deadline the loop waits on the ports, so bytes are dated when they arrive, and writes the
arm's set-points when their own timer says so. The last moments before a deadline are kept free for it. A tick
that comes late skips whole periods; it never makes up for them.
"""

from __future__ import annotations

import logging
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from palmd.daemon.bus import Bus
from palmd.daemon.core import Core
from palmd.daemon.drivers import EndName
from palmd.daemon.lifecycle import State
from palmd.daemon.processor_time import ProcessorTime
from palmd.daemon.realtime import rss_mb
from palmd.daemon.statistics import LoopStatistics
from palmd.daemon.systemd import Notifier
from palmd.devices.port import DevicePort, PortWaiter
from palmd.faults import Fault
from palmd.messages import Fields
from palmd.quantities import CONFIG, INFO, LOOP, Topic

log = logging.getLogger(__name__)

STOPPING_S = 1.5
"""How long the end may wait for the arm to report that it stands."""

SLOW_TOPIC_S = 1.0 / LOOP.rate_hz

QUIET_S = 0.3e-3
"""So long before a tick nothing is begun that could delay it; what comes is dated, and seen to in the tick."""

OBSERVING_SHARE = 0.5
"""Of a period, after which the observer begins no further event in a tick."""

TEND_S = 0.25
"""How often each process beside the loop is looked after."""

AWAKE_S = 0.1e-3
"""So long before a tick the loop no longer sleeps, for no machine wakes anybody to the microsecond."""


def next_deadline(deadline: float, now: float, period: float) -> tuple[float, int]:
    """The first deadline of the grid after `now` (s), and how many between were missed."""
    skipped = max(0, math.floor((now - deadline) / period))
    return deadline + (skipped + 1) * period, skipped


class Waiter(Protocol):
    """What waits on the ports; see `PortWaiter`."""

    def wait(self, t_deadline: float) -> list[DevicePort]:
        """The ports where something has come, or none once `t_deadline` (s) has."""


class Loop:
    """Runs the core on real ports, sockets and clocks; see the module."""

    def __init__(
        self,
        core: Core,
        ports: Mapping[EndName, DevicePort],
        bus: Bus,
        notifier: Notifier,
        *,
        rate_hz: float,
        backend: str,
        info: Fields,
        info_topic: Topic = INFO,
        config: Fields | None = None,
        counters: Callable[[], Fields] = dict,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
        waiter: Waiter | None = None,
        processor: ProcessorTime | None = None,
        tend: Sequence[Callable[[float], None]] = (),
    ) -> None:
        """`info` is what `info_topic` says, `config` what `palm/config` does, `counters` gives what `palm/loop`
        says beyond the loop's own.

        `clock` gives the time (s) of all that is done, `wall` that of the calendar; `waiter` waits on the ports;
        `processor` says who had it when a tick is late, if it is to be said. `tend` are called with the time (s) a few
        times a second: each looks after a process beside the loop, and takes 1 ms at most.
        """
        self.statistics = LoopStatistics(rate_hz)
        self._core = core
        self._ports = dict(ports)
        self._ends = {port: end for end, port in self._ports.items()}
        self._arm_port = self._ports["arm"]
        self._bus = bus
        self._notifier = notifier
        self._period = 1.0 / rate_hz
        self._backend = backend
        self._info, self._info_topic, self._config = info, info_topic, config
        self._counters = counters
        self._clock, self._wall = clock, wall
        self._waiter: Waiter = waiter or PortWaiter(list(self._ports.values()), clock)
        self._processor = processor
        self._tend = tuple(tend)
        self._t_tend = -math.inf
        self._known_open: set[EndName] = set()
        self._stop_wanted = False
        self._t_stop = math.inf
        self._deadline = -math.inf
        self._arrived: list[tuple[DevicePort, bytes, float]] = []
        self._busy_s = 0.0  # spent on bytes since the last tick
        self._failed = False
        self._t_slow = -math.inf
        self._told_ready = False
        self._told_state: tuple[State, tuple[Fault, ...]] = (core.state, ())
        self._told_errors: dict[EndName, str | None] = {}
        self._parts: tuple[Callable[[float], None], ...] = (
            self._take_in,
            self._open_ports,
            self._observe,
            self._obey,
            core.decide,
            self._answer,
            self._publish,
            self._publish_slowly,
            self._look_after,
            self._tell,
        )

    def stop(self) -> None:
        """Ask for a planned stop and the end of `run`; may be called from a signal handler."""
        self._stop_wanted = True

    def run(self) -> bool:
        """Tick until asked to stop; returns whether the arm is known to stand in the end."""
        self.begin()
        while not self.over():
            self.period()
        return self._core.at_rest

    def begin(self) -> None:
        """Open the ports; the first tick is due a period later."""
        self._open_ports(self._clock())
        self._deadline = self._clock() + self._period

    def period(self) -> None:
        """Attend to the ports until the next tick is due, and do it."""
        deadline = self._deadline
        self._attend(deadline)
        begun = self._clock()
        healthy = self._tick(begun)
        ended = self._clock()
        self._deadline, skipped = next_deadline(deadline, ended, self._period)
        self.statistics.tick(begun - deadline, ended - begun + self._busy_s, skipped)
        self._busy_s = 0.0
        if skipped:
            self._core.overran(ended, ended - deadline, self._processor.lost() if self._processor else "")
        elif healthy:
            self._notifier.healthy(ended)

    def over(self) -> bool:
        """Whether the end was asked for and the arm stands, or has had its time to."""
        if not self._stop_wanted:
            return False
        now = self._clock()
        if math.isinf(self._t_stop):
            self._t_stop = now
            self._notifier.stopping()
            log.info("stopping")
            self._core.close()
            return False  # one more tick at least, for the stop to go out
        return self._core.at_rest or now - self._t_stop > STOPPING_S

    # ---- between ticks -----------------------------------------------------------------------------------

    def _attend(self, deadline: float) -> None:
        """Until the deadline read what comes and write what falls due, the latter not when it is near."""
        t_quiet, t_awake = deadline - QUIET_S, deadline - AWAKE_S
        while (begun := self._clock()) < t_awake:
            if begun >= t_quiet:
                self._read(t_awake)
                continue
            self._read(min(t_quiet, self._core.due()))
            begun = self._clock()
            if begun < t_quiet:
                self._see_to()
                if self._clock() < t_quiet:
                    self._write()
                self._busy_s += self._clock() - begun
        while self._clock() < deadline:
            pass

    def _read(self, t_end: float) -> None:
        """Wait for bytes, no longer than until `t_end` (s), and date them."""
        for port in self._waiter.wait(t_end):
            data = port.read()
            self._arrived.append((port, data, self._clock()))

    def _see_to(self) -> None:
        """Give the core what has arrived."""
        arrived, self._arrived = self._arrived, []
        for port, data, t in arrived:
            end = self._ends[port]
            if data:
                try:
                    self._core.receive(end, data, t)
                except Exception as error:
                    self._fail(t, error)
            if not port.is_open and end in self._known_open:
                self._lost(end, t)

    def in_hand(self, end: EndName) -> int:
        """How many bytes of a port have been read and wait for the tick."""
        return sum(len(data) for port, data, _ in self._arrived if port is self._ports[end])

    def _write(self) -> None:
        """What falls due to the arm; a pad that has been let go since the last tick makes it brake."""
        t = self._clock()
        if t < self._core.due():
            return
        self._read(-math.inf)
        try:
            if not self._arrived:  # else the tick will tell: silence is judged where nothing lies unread
                self._core.look(t)
            t = self._clock()
            data = self._core.transmit(t)
        except Exception as error:
            self._fail(t, error)
            return
        if data:
            self._arm_port.write(data)
            if not self._arm_port.is_open:
                self._lost("arm", t)

    # ---- the tick ----------------------------------------------------------------------------------------

    def _tick(self, t: float) -> bool:
        """One tick at `t` (s); returns whether it went well.

        A part that raises does not keep the others from their work. Set-points may fall due between parts.
        """
        healthy = True
        for part in self._parts:
            try:
                part(t)
            except Exception as error:
                self._fail(t, error)
                healthy = False
            self._write()
        return healthy

    def _take_in(self, _t: float) -> None:
        self._read(-math.inf)
        self._see_to()

    def _observe(self, t: float) -> None:
        t_enough = t + OBSERVING_SHARE * self._period

        def between() -> bool:
            self._write()
            return self._clock() < t_enough

        self._core.observe(t, between)

    def _obey(self, t: float) -> None:
        for request in self._bus.receive(self._core.in_control):
            self._core.handle(request, t)

    def _answer(self, _t: float) -> None:
        for reply in self._core.replies():
            self._bus.reply(reply)

    def _publish(self, t: float) -> None:
        timestamp = self._wall()
        for topic, fields in self._core.report(t):
            self._bus.publish(topic, fields, t, timestamp)

    def _publish_slowly(self, t: float) -> None:
        if t - self._t_slow >= SLOW_TOPIC_S - 0.5 * self._period:
            self._t_slow = t
            if self._processor:
                self._processor.forget()
            timestamp = self._wall()
            self._bus.publish(LOOP, self._loop_fields(), t, timestamp)
            self._bus.publish(self._info_topic, dict(self._info), t, timestamp)
            if self._config is not None:
                self._bus.publish(CONFIG, dict(self._config), t, timestamp)

    def _look_after(self, t: float) -> None:
        """One process a time, so that no tick starts two."""
        if self._tend and t - self._t_tend >= TEND_S / len(self._tend):
            self._t_tend = t
            self._tend[0](t)
            self._tend = (*self._tend[1:], self._tend[0])

    def _fail(self, t: float, error: Exception) -> None:
        if not self._failed:
            self._failed = True
            log.exception("unexpected error in the control loop; this is told once")
        self._core.fail(t, error)

    def _open_ports(self, t: float) -> None:
        """Try the shut ports again, and let pads do there what their start-up wants."""
        for end, port in self._ports.items():
            if end not in self._known_open and port.poll_open(t):
                self._known_open.add(end)
                self._core.opened(end, t)
            if port.error != self._told_errors.get(end, ""):
                self._told_errors[end] = port.error
                log.warning("%s", port.error) if port.error else log.info("%s: %s is open", end, port.path)
        for end, pad in self._core.pads.items():
            pad.tend(self._ports[end], t)

    def _lost(self, end: EndName, t: float) -> None:
        self._known_open.discard(end)
        self._core.lost(end, t)

    def _loop_fields(self) -> Fields:
        fields: Fields = self.statistics.fields() | self._core.counters() | self._bus.fields() | self._counters()
        for end, port in self._ports.items():
            port.update_counters()
            fields |= {f"{end}_port_{what}": count for what, count in port.counters.as_dict().items()}
        return fields | {"rss_mb": rss_mb(), "blocks": sys.getallocatedblocks(), "backend": self._backend}

    def _tell(self, _t: float) -> None:
        """Log what has changed, and tell the service manager."""
        state, faults = self._core.state, self._core.faults.active
        before, active = self._told_state
        if state is before and faults is active:
            return
        self._told_state = (state, faults)
        for fault in faults:
            if fault not in active:
                log.warning("fault %s (%s): %s: %s", fault.code, fault.severity, fault.text, fault.hint)
        for fault in active:
            if fault not in faults:
                log.info("fault %s is over", fault.code)
        if state is not before:
            log.info("%s -> %s", before, state)
        if state is not State.IDLE and not self._told_ready:
            self._told_ready = True
            self._notifier.ready()
        self._notifier.status(f"{state}" + "".join(f", {fault.code}" for fault in faults))
