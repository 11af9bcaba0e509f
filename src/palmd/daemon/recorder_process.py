"""The recorder process that `palmd run` starts; it is restarted if it is killed."""

from __future__ import annotations

import logging
import math
import subprocess
from collections.abc import Callable

log = logging.getLogger(__name__)

RESTART_S = 2.0
"""Shortest time between two starts."""

FINAL_STATUSES = frozenset({0, 1, 2, 3})
"""Exit statuses after which the recorder is not restarted: it was asked to end, or cannot record and has reported why.
"""


class RecorderProcess:
    """`tend` is safe inside the loop: a start takes 1 ms."""

    def __init__(self, start: Callable[[], subprocess.Popen[bytes]]) -> None:
        """Start the recorder; raises OSError if that fails."""
        self._start = start
        self._process = start()
        self._t_started = -math.inf
        self._over = False

    def tend(self, t: float) -> None:
        """Restart the recorder at `t` (s) if it has been killed. Call a few times a second."""
        if self._over or (status := self._process.poll()) is None:
            return
        if status in FINAL_STATUSES:
            self._over = True
            log.warning("the recorder has ended with status %d: the run is not recorded", status)
        elif t - self._t_started >= RESTART_S:
            self._t_started = t
            try:
                self._process = self._start()
            except OSError as error:
                log.warning("the recorder was killed (status %d) and cannot be restarted: %s", status, error)
            else:
                log.warning("the recorder was killed (status %d): restarted", status)
