"""Reads a pad's reports outside the daemon, for bring-up and calibration."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Self

from palmd.config.pads import PadConfig
from palmd.devices.pad import PadReport, make_pad
from palmd.devices.port import PortUnavailableError


class PadListener:
    """A pad at its open port, a context manager. All methods raise PortUnavailableError."""

    def __init__(self, number: int, config: PadConfig) -> None:
        """Open the port."""
        t = time.monotonic()
        self.driver = make_pad(number, config)
        self.port = self.driver.port()
        if not self.port.poll_open(t):
            raise PortUnavailableError(self.port.error)
        self.driver.opened(t)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.port.close()

    def read(self) -> Sequence[PadReport]:
        """Return the new reports, and serve the pad."""
        data = self.port.read()
        t = time.monotonic()
        reports = self.driver.reports(data, t)
        self.driver.tend(self.port, t)
        if not self.port.is_open:
            raise PortUnavailableError(self.port.error)
        return reports
