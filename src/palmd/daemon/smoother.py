"""`python -m palmd.daemon.smoother ADDRESS PARENT RIG`: the process that `daemon.smoothing` starts.

Its life is tied to its parent's before anything slow is imported, so that it never outlives a daemon that was killed.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def main(address: str, parent: int, rig: str) -> None:
    """Serve the daemon with process number `parent` at the ZeroMQ `address`; `rig` as `smoothing.serve` takes it."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has died already
        return
    from palmd.daemon import smoothing

    smoothing.serve(address, rig)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
