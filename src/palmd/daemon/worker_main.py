"""`python -m palmd.daemon.worker_main MODULE PARENT FD ARGUMENT…`: a process beside the loop (`daemon.worker`).

It is tied to its parent's life before anything slow is imported, so that it never outlives a daemon that was killed.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence

from palmd import blas

_PR_SET_PDEATHSIG = 1


HEARTBEAT_S = 0.25
"""Period of heartbeats."""


def main(module: str, parent: int, heartbeat_fd: int, arguments: Sequence[str]) -> None:
    """Call `serve` of a module with the arguments, for the daemon with process id `parent`.

    `heartbeat_fd` is the file descriptor on which the daemon receives heartbeats.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # the parent has already died
        return
    threading.Thread(target=_send_heartbeats, args=(heartbeat_fd,), name="signs", daemon=True).start()
    blas.one_thread_from_here()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the loop, which then stops this process
    importlib.import_module(module).serve(*arguments)


def _send_heartbeats(descriptor: int) -> None:
    """Runs in its own thread, so that a long computation does not look like a stopped process."""
    while True:
        with contextlib.suppress(BlockingIOError):
            os.write(descriptor, b".")
        time.sleep(HEARTBEAT_S)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
