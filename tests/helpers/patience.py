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
        self._t, (self._waited, _) = time.monotonic(), told()

    def share(self):
        """0 to 1, the last ten seconds counted in, for the kernel counts in steps of two; 1 where it does not tell."""
        waited, lately = told()
        return max(lately, (waited - self._waited) / max(time.monotonic() - self._t, 2.0))


def told(path=PRESSURE):
    """Seconds since boot in which somebody waited for a processor, and the share of the last ten seconds (0 to 1)."""
    try:
        some = path.read_text().splitlines()[0]
        fields = dict(field.split("=") for field in some.split()[1:])
        return float(fields["total"]) * 1e-6, float(fields["avg10"]) * 1e-2
    except (OSError, ValueError, IndexError, KeyError):
        return 0.0, 1.0


def until_quiet(longest_s):
    """Wait for a quieter moment, for so long (s) at most."""
    t_end = time.monotonic() + longest_s
    while time.monotonic() < t_end and told()[1] > QUIET_SHARE:
        time.sleep(LOOK_S)
