"""`python -m palmd.daemon.worker_main MODULE PARENT SIGNS ARGUMENT…`: a process beside the loop (`daemon.worker`).

Its life is tied to its parent's before anything slow is imported, so that it never outlives a daemon that was killed.
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


SIGN_S = 0.25
"""From one sign of life to the next."""


def main(module: str, parent: int, signs: int, arguments: Sequence[str]) -> None:
    """Call `serve` of a module with the arguments, for the daemon with process number `parent`.

    `signs` is the descriptor on which it hears that this process lives.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has died already
        return
    threading.Thread(target=_give_signs, args=(signs,), name="signs", daemon=True).start()
    blas.one_thread_from_here()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the loop, which ends this process in its turn
    importlib.import_module(module).serve(*arguments)


def _give_signs(descriptor: int) -> None:
    """In a thread of its own, so that a long computation is not taken for a process that was stopped."""
    while True:
        with contextlib.suppress(BlockingIOError):
            os.write(descriptor, b".")
        time.sleep(SIGN_S)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
