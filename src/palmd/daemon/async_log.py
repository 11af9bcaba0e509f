"""Log lines to standard error without blocking the loop, even if nobody reads them."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import threading

from palmd.daemon import realtime
from palmd.logformat import formatter

MAX_QUEUED_LINES = 1000
FLUSH_TIMEOUT_S = 0.5
"""How long `close` waits for queued lines to be written."""


class AsyncLog(logging.Handler):
    """Logging handler that passes lines to a writer thread and drops them if the thread does not keep up."""

    def __init__(self, fd: int = 2) -> None:
        """`fd` is the file descriptor to write to; a write may block the thread, but nothing else."""
        super().__init__()
        self.setFormatter(formatter(fd))
        self._fd = fd
        self._lines: queue.Queue[str | None] = queue.Queue(MAX_QUEUED_LINES)
        self._thread = threading.Thread(target=self._write, name="journal", daemon=True)
        self._thread.start()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue one line. Safe in the loop."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(self.format(record))

    def close(self) -> None:
        """Write the queued lines, waiting `FLUSH_TIMEOUT_S` at most."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(None)
            self._thread.join(FLUSH_TIMEOUT_S)
        super().close()

    def _write(self) -> None:
        realtime.raise_helper_priority()
        while (line := self._lines.get()) is not None:
            with contextlib.suppress(OSError):
                os.write(self._fd, line.encode(errors="replace") + b"\n")


def start_async_log() -> AsyncLog:
    """Send this process's log (level INFO) to standard error; the caller closes the returned handler at the end."""
    journal = AsyncLog()
    root = logging.getLogger()
    root.handlers[:] = [journal]
    root.setLevel(logging.INFO)
    return journal
