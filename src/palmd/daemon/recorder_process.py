"""The recorder that `palmd run` starts beside itself: started again when it is killed."""

from __future__ import annotations

import logging
import math
import subprocess
from collections.abc import Callable

log = logging.getLogger(__name__)

AGAIN_S = 2.0
"""From one start to the next at least."""

MEANT = frozenset({0, 1, 2, 3})
"""Exit statuses with which a recorder ends by itself: it was asked to, or cannot record at all and has said why."""


class RecorderProcess:
    """`tend` is safe inside the loop: a start takes it 1 ms."""

    def __init__(self, start: Callable[[], subprocess.Popen[bytes]]) -> None:
        """Start it; raises OSError when that cannot be done."""
        self._start = start
        self._process = start()
        self._t_started = -math.inf
        self._over = False

    def tend(self, t: float) -> None:
        """Start it again at `t` (s) if it has been killed. A few times a second."""
        if self._over or (status := self._process.poll()) is None:
            return
        if status in MEANT:
            self._over = True
            log.warning("the recorder has ended with status %d: nothing is recorded", status)
        elif t - self._t_started >= AGAIN_S:
            self._t_started = t
            try:
                self._process = self._start()
            except OSError as error:
                log.warning("the recorder was killed (status %d) and cannot be started again: %s", status, error)
            else:
                log.warning("the recorder was killed (status %d): started again", status)
