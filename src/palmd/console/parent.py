"""The end of the process that has started this one ends this one too."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PARENT_VARIABLE = "PALMD_PARENT"
"""Names the process whose end asks this one to end, where another palmd has started it."""

_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """Ask for SIGTERM at the end of the process that `PARENT_VARIABLE` names, if any. First thing in a process."""
    parent = os.environ.pop(PARENT_VARIABLE, "")
    if not parent:
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # it has ended already
        sys.exit(0)
