"""`python -m palmd.daemon.worker_main MODULE PARENT ARGUMENT…`: a process beside the loop (`daemon.worker`).

Its life is tied to its parent's before anything slow is imported, so that it never outlives a daemon that was killed.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import signal
import sys
from collections.abc import Sequence

from palmd import blas

_PR_SET_PDEATHSIG = 1


def main(module: str, parent: int, arguments: Sequence[str]) -> None:
    """Call `serve` of a module with the arguments, for the daemon with process number `parent`."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has died already
        return
    blas.one_thread_from_here()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the loop, which ends this process in its turn
    importlib.import_module(module).serve(*arguments)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3:])
