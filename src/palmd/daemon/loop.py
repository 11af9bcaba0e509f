"""The 100 Hz loop: one thread on a grid of deadlines, with the ports and sockets.

Until a tick's deadline the loop waits on the ports, so that bytes get the time at which they arrive, and writes the
arm's set-points when these are due. The last moments before a deadline are kept free. A tick that comes late skips
whole periods; skipped ticks are not made up for.
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
"""Longest time to wait at the end for the arm to report that it is at rest."""

SLOW_TOPIC_S = 1.0 / LOOP.rate_hz

QUIET_S = 0.3e-3
"""In this interval before a tick no work is begun; arriving bytes are time-stamped and processed in the tick."""

OBSERVING_SHARE = 0.5
"""Share of a period after which the observer takes no further event in a tick."""

TEND_S = 0.25
"""Period in which each process beside the loop is checked."""

AWAKE_S = 0.1e-3
"""In this interval before a tick the loop busy-waits, because no machine wakes a thread to the microsecond."""


def next_deadline(deadline: float, now: float, period: float) -> tuple[float, int]:
    """The first deadline of the grid after `now` (s), and how many before it were missed."""
    skipped = max(0, math.floor((now - deadline) / period))
    return deadline + (skipped + 1) * period, skipped


class Waiter(Protocol):
    """Waits on the ports; see `PortWaiter`."""

    def wait(self, t_deadline: float) -> list[DevicePort]:
        """The ports with data, or none once `t_deadline` (s) is reached."""


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
        """`info` are the fields of `info_topic`, `config` those of `palm/config`.

        `counters` gives further fields of `palm/loop`. `clock` gives the time (s) of everything that happens, `wall`
        the calendar time; `waiter` waits on the ports; `processor`, if given, explains why a tick was late. `tend` are
        called with the time (s) a few times a second: each checks one process beside the loop and takes 1 ms at most.
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
        self._open_ends: set[EndName] = set()
        self._stop_requested = False
        self._t_stop = math.inf
        self._deadline = -math.inf
        self._arrived: list[tuple[DevicePort, bytes, float]] = []
        self._busy_s = 0.0  # spent on processing bytes since the last tick
        self._failed = False
        self._t_slow = -math.inf
        self._ready_sent = False
        self._logged_state: tuple[State, tuple[Fault, ...]] = (core.state, ())
        self._logged_errors: dict[EndName, str | None] = {}
        self._parts: tuple[Callable[[float], None], ...] = (
            self._receive,
            self._poll_ports,
            self._observe,
            self._handle_commands,
            core.decide,
            self._send_replies,
            self._publish,
            self._publish_slow_topics,
            self._tend_next,
            self._log_changes,
        )

    def stop(self) -> None:
        """Request a planned stop and the end of `run`; may be called from a signal handler."""
        self._stop_requested = True

    def run(self) -> bool:
        """Tick until `stop`; returns whether the arm is known to be at rest at the end."""
        self.begin()
        while not self.over():
            self.period()
        return self._core.at_rest

    def begin(self) -> None:
        """Open the ports; the first tick is due one period later."""
        self._poll_ports(self._clock())
        self._deadline = self._clock() + self._period

    def period(self) -> None:
        """Serve the ports until the next tick is due, then execute it."""
        deadline = self._deadline
        self._serve_ports(deadline)
        started = self._clock()
        healthy = self._tick(started)
        ended = self._clock()
        self._deadline, skipped = next_deadline(deadline, ended, self._period)
        self.statistics.tick(started - deadline, ended - started + self._busy_s, skipped)
        self._busy_s = 0.0
        if skipped:
            self._core.overran(ended, ended - deadline, self._processor.lost() if self._processor else "")
        elif healthy:
            self._notifier.healthy(ended)

    def over(self) -> bool:
        """Whether the end was requested, and the arm is at rest or `STOPPING_S` have passed."""
        if not self._stop_requested:
            return False
        now = self._clock()
        if math.isinf(self._t_stop):
            self._t_stop = now
            self._notifier.stopping()
            log.info("stopping")
            self._core.close()
            return False  # at least one more tick, to send the stop
        return self._core.at_rest or now - self._t_stop > STOPPING_S

    # ---- between ticks -----------------------------------------------------------------------------------

    def _serve_ports(self, deadline: float) -> None:
        """Until the deadline read what arrives and write what is due; no writes close to the deadline."""
        t_quiet, t_awake = deadline - QUIET_S, deadline - AWAKE_S
        while (now := self._clock()) < t_awake:
            if now >= t_quiet:
                self._read(t_awake)
                continue
            self._read(min(t_quiet, self._core.due()))
            now = self._clock()
            if now < t_quiet:
                self._process_arrived()
                if self._clock() < t_quiet:
                    self._write()
                self._busy_s += self._clock() - now
        while self._clock() < deadline:
            pass

    def _read(self, t_end: float) -> None:
        """Wait for bytes until `t_end` (s) at most, and time-stamp them."""
        for port in self._waiter.wait(t_end):
            data = port.read()
            self._arrived.append((port, data, self._clock()))

    def _process_arrived(self) -> None:
        """Pass to the core what has arrived."""
        arrived, self._arrived = self._arrived, []
        for port, data, t in arrived:
            end = self._ends[port]
            if data:
                try:
                    self._core.receive(end, data, t)
                except Exception as error:
                    self._fail(t, error)
            if not port.is_open and end in self._open_ends:
                self._lost(end, t)

    def pending_bytes(self, end: EndName) -> int:
        """How many bytes of a port have been read and not been processed yet."""
        return sum(len(data) for port, data, _ in self._arrived if port is self._ports[end])

    def _write(self) -> None:
        """Write what is due to the arm; if a pad has lost contact since the last tick, the set-point brakes."""
        t = self._clock()
        if t < self._core.due():
            return
        self._read(-math.inf)
        try:
            if not self._arrived:  # silence can be judged only if nothing is unread; otherwise the tick does it
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
        """Execute one tick at `t` (s); returns whether no part failed.

        A part that raises does not prevent the others. Set-points may be due between parts.
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

    def _receive(self, _t: float) -> None:
        self._read(-math.inf)
        self._process_arrived()

    def _observe(self, t: float) -> None:
        t_end = t + OBSERVING_SHARE * self._period

        def between() -> bool:
            self._write()
            return self._clock() < t_end

        self._core.observe(t, between)

    def _handle_commands(self, t: float) -> None:
        for request in self._bus.receive(self._core.in_control):
            self._core.handle(request, t)

    def _send_replies(self, _t: float) -> None:
        for reply in self._core.replies():
            self._bus.reply(reply)

    def _publish(self, t: float) -> None:
        timestamp = self._wall()
        for topic, fields in self._core.report(t):
            self._bus.publish(topic, fields, t, timestamp)

    def _publish_slow_topics(self, t: float) -> None:
        if t - self._t_slow >= SLOW_TOPIC_S - 0.5 * self._period:
            self._t_slow = t
            if self._processor:
                self._processor.forget()
            timestamp = self._wall()
            self._bus.publish(LOOP, self._loop_fields(), t, timestamp)
            self._bus.publish(self._info_topic, dict(self._info), t, timestamp)
            if self._config is not None:
                self._bus.publish(CONFIG, dict(self._config), t, timestamp)

    def _tend_next(self, t: float) -> None:
        """Check one process at a time, so that no tick starts two."""
        if self._tend and t - self._t_tend >= TEND_S / len(self._tend):
            self._t_tend = t
            self._tend[0](t)
            self._tend = (*self._tend[1:], self._tend[0])

    def _fail(self, t: float, error: Exception) -> None:
        if not self._failed:
            self._failed = True
            log.exception("unexpected error in the control loop; further ones are not logged")
        self._core.fail(t, error)

    def _poll_ports(self, t: float) -> None:
        """Try to open closed ports, and let pads run their start-up handshake."""
        for end, port in self._ports.items():
            if end not in self._open_ends and port.poll_open(t):
                self._open_ends.add(end)
                self._core.opened(end, t)
            if port.error != self._logged_errors.get(end, ""):
                self._logged_errors[end] = port.error
                log.warning("%s", port.error) if port.error else log.info("%s: %s is open", end, port.path)
        for end, pad in self._core.pads.items():
            pad.tend(self._ports[end], t)

    def _lost(self, end: EndName, t: float) -> None:
        self._open_ends.discard(end)
        self._core.lost(end, t)

    def _loop_fields(self) -> Fields:
        fields: Fields = self.statistics.fields() | self._core.counters() | self._bus.fields() | self._counters()
        for end, port in self._ports.items():
            port.update_counters()
            fields |= {f"{end}_port_{what}": count for what, count in port.counters.as_dict().items()}
        return fields | {"rss_mb": rss_mb(), "blocks": sys.getallocatedblocks(), "backend": self._backend}

    def _log_changes(self, _t: float) -> None:
        """Log changes of state and faults, and notify the service manager."""
        state, faults = self._core.state, self._core.faults.active
        before, active = self._logged_state
        if state is before and faults is active:
            return
        self._logged_state = (state, faults)
        for fault in faults:
            if fault not in active:
                log.warning("fault %s (%s): %s: %s", fault.code, fault.severity, fault.text, fault.hint)
        for fault in active:
            if fault not in faults:
                log.info("fault %s is over", fault.code)
        if state is not before:
            log.info("%s -> %s", before, state)
        if state is not State.IDLE and not self._ready_sent:
            self._ready_sent = True
            self._notifier.ready()
        self._notifier.status(f"{state}" + "".join(f", {fault.code}" for fault in faults))
