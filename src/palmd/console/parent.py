"""Ends this process with the process that has started it."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PARENT_VARIABLE = "PALMD_PARENT"
"""Environment variable with the id of the palmd process that has started this one."""

_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """Request SIGTERM at the end of the process in `PARENT_VARIABLE`, if set. Call it first in a process."""
    parent = os.environ.pop(PARENT_VARIABLE, "")
    if not parent:
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # it has ended already
        sys.exit(0)
