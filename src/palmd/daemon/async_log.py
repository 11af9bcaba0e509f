"""Log lines on standard error that cannot hold up the loop, even when nobody reads them."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import threading

from palmd.daemon import realtime
from palmd.logformat import formatter

LINES_WAITING_MAX = 1000
LAST_WORDS_S = 0.5
"""How long the end may wait for lines to be written."""


class AsyncLog(logging.Handler):
    """Hands lines to a thread that writes them, and drops them when it does not keep up."""

    def __init__(self, fd: int = 2) -> None:
        """`fd` is where the lines go: a write there may block, but only the thread."""
        super().__init__()
        self.setFormatter(formatter(fd))
        self._fd = fd
        self._lines: queue.Queue[str | None] = queue.Queue(LINES_WAITING_MAX)
        self._thread = threading.Thread(target=self._write, name="journal", daemon=True)
        self._thread.start()

    def emit(self, record: logging.LogRecord) -> None:
        """Take one line. Safe in the loop."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(self.format(record))

    def close(self) -> None:
        """Write what is left, as far as that goes without waiting long."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(None)
            self._thread.join(LAST_WORDS_S)
        super().close()

    def _write(self) -> None:
        realtime.accompany()
        while (line := self._lines.get()) is not None:
            with contextlib.suppress(OSError):
                os.write(self._fd, line.encode(errors="replace") + b"\n")


def start_async_log() -> AsyncLog:
    """Send this process's log, from INFO on, to standard error; `close` what is returned at the end."""
    journal = AsyncLog()
    root = logging.getLogger()
    root.handlers[:] = [journal]
    root.setLevel(logging.INFO)
    return journal
