"""Serves an actuator outside the daemon, for bring-up and calibration; `padlistener` does so for a pad."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Self

from palmd.config.arms import ArmConfig
from palmd.devices.actuator import ArmPose, ArmReport, make_actuator
from palmd.devices.port import PortUnavailableError, PortWaiter

_LONGEST_S = 0.02


class ArmListener:
    """An actuator at its open port, a context manager. All methods raise PortUnavailableError."""

    def __init__(self, config: ArmConfig) -> None:
        """Open the port."""
        self.driver = make_actuator(config)
        self.port = self.driver.port()
        if not self.port.poll_open(time.monotonic()):
            raise PortUnavailableError(self.port.error)
        self._waiter = PortWaiter([self.port])
        self._t_written = 0.0
        self.latencies_s: list[float] = []
        """Time from the last request to each report."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.port.close()

    def read(self, target: Callable[[float], ArmPose | None] = lambda _: None) -> list[ArmReport]:
        """Wait for the next bytes or request, at most 20 ms; return the new reports.

        target: the set-point at a time (s) while tracking.
        """
        self._waiter.wait(min(self.driver.due(), time.monotonic() + _LONGEST_S))
        t = time.monotonic()
        reports = self.driver.feed(self.port.read(), t)
        self.latencies_s += [t - self._t_written] * bool(reports)
        data = self.driver.poll(t, target(t)).data
        if data:
            self._t_written = t
            self.port.write(data)
        if not self.port.is_open:
            raise PortUnavailableError(self.port.error)
        return reports
