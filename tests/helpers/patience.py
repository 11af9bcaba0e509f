"""Measures how busy the machine is with other work, and waits for a quieter moment."""

import time
from pathlib import Path

PRESSURE = Path("/proc/pressure/cpu")
BUSY_SHARE = 0.05  # share of time in which a task waited for a processor; about 0.01 in rig tests on an idle machine
QUIET_SHARE = 0.2
LOOK_S = 5.0


class Pressure:
    """Share of the time since creation in which some task waited for a processor."""

    def __init__(self):
        self._t, (self._waited, _) = time.monotonic(), pressure()

    def share(self):
        """0 to 1, including the last ten seconds because the kernel updates every 2 s; 1 where the kernel does not
        report it.
        """
        waited, lately = pressure()
        return max(lately, (waited - self._waited) / max(time.monotonic() - self._t, 2.0))


def pressure(path=PRESSURE):
    """Seconds since boot in which some task waited for a processor, and its share of the last ten seconds (0 to 1)."""
    try:
        some = path.read_text().splitlines()[0]
        fields = dict(field.split("=") for field in some.split()[1:])
        return float(fields["total"]) * 1e-6, float(fields["avg10"]) * 1e-2
    except (OSError, ValueError, IndexError, KeyError):
        return 0.0, 1.0


def until_quiet(longest_s):
    """Waits for a quieter moment, at most so long (s)."""
    t_end = time.monotonic() + longest_s
    while time.monotonic() < t_end and pressure()[1] > QUIET_SHARE:
        time.sleep(LOOK_S)
