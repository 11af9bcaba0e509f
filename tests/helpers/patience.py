"""How busy the machine is with other work, and waiting for the end of that."""

import time
from pathlib import Path

PRESSURE = Path("/proc/pressure/cpu")
BUSY_SHARE = 0.05  # of the time in which somebody waited for a processor; an idle machine's rig tests have a hundredth
QUIET_SHARE = 0.2
LOOK_S = 5.0


class Pressure:
    """The share of the time since it was made in which somebody waited for a processor."""

    def __init__(self):
        self._t, self._waited = time.monotonic(), waited_s()

    def share(self):
        """0 to 1; 1 where the kernel does not tell."""
        waited = waited_s()
        if waited is None:
            return 1.0
        return (waited - self._waited) / max(time.monotonic() - self._t, 1e-3)


def waited_s():
    """Seconds since boot in which somebody waited for a processor; None where the kernel does not tell."""
    try:
        return float(PRESSURE.read_text().splitlines()[0].rpartition("total=")[2]) * 1e-6
    except (OSError, ValueError, IndexError):
        return None


def until_quiet(longest_s):
    """Wait for a quieter moment, for so long (s) at most."""
    t_end = time.monotonic() + longest_s
    while time.monotonic() < t_end:
        pressure = Pressure()
        time.sleep(LOOK_S)
        if pressure.share() < QUIET_SHARE:
            return
