"""Measures this machine's wake-up latency, the lower bound of any program's lateness.

It uses cyclictest (Debian: rt-tests) if it is installed, else a timer in Python; the result names the meter.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from palmd.daemon.realtime import PRIORITY

ABOVE = PRIORITY + 1
"""Priority just above the loop's, so that the loop does not disturb the measurement; costs the loop 20 µs a period."""

LATEST_US = 100_000
_MCL_CURRENT = 1


@dataclass(frozen=True, slots=True)
class Wakeups:
    """Lateness of each wake-up (ms), and the name of the meter."""

    lateness_ms: tuple[float, ...]
    by: str


class Meter:
    """Measures in a separate process."""

    def __init__(self, seconds: float, period_s: float, folder: Path) -> None:
        """Start at once; `folder` is for its report. Raises OSError if the process cannot be started."""
        self._report = folder / "wakeups.json"
        self._report.unlink(missing_ok=True)
        count = max(1, round(seconds / period_s))
        program = shutil.which("cyclictest")
        self._is_cyclictest = program is not None and _may_be_urgent()
        if self._is_cyclictest:
            options: dict[str, int | Path] = {
                "threads": 1,
                "priority": ABOVE,
                "loops": count,
                "interval": round(period_s * 1e6),
            }
            options |= {"histogram": LATEST_US, "json": self._report}
            command = [str(program), "--quiet", "--mlockall", *(f"--{key}={value}" for key, value in options.items())]
        else:
            command = [sys.executable, "-P", "-m", __name__, str(count), str(period_s), str(self._report)]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def result(self) -> Wakeups | None:
        """Wait for the end and return the result; None if it failed."""
        if self._process.wait() != 0 or not self._report.exists():
            return None
        report = json.loads(self._report.read_text(encoding="utf-8"))
        if self._is_cyclictest:
            return Wakeups(spread(report["thread"]["0"]["histogram"]), "cyclictest")
        return Wakeups(tuple(report["lateness_ms"]), "a timer in Python" + ("" if report["fifo"] else ", not FIFO"))

    def close(self) -> None:
        """End the process if it still runs."""
        self._process.kill()
        self._process.wait()


def spread(histogram: dict[str, int]) -> tuple[float, ...]:
    """Convert a histogram (counts by integer microseconds) to single values (ms), sorted. Pure."""
    return tuple(int(us) * 1e-3 for us in sorted(histogram, key=int) for _ in range(histogram[us]))


def _may_be_urgent() -> bool:
    """Whether this user may use the priority; tried in a child process, since this one keeps its own."""
    attempt = f"import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({ABOVE}))"
    return subprocess.run([sys.executable, "-S", "-c", attempt], capture_output=True, check=False).returncode == 0


def _measure(count: int, period_s: float, report: Path) -> None:
    """The timer in Python: measure the lateness at absolute deadlines."""
    fifo = True
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(ABOVE))
        ctypes.CDLL(None).mlockall(_MCL_CURRENT)
    except OSError:
        fifo = False
    gc.disable()
    lateness_ms = []
    due = time.monotonic()
    for _ in range(count):
        due += period_s
        time.sleep(max(0.0, due - time.monotonic()))
        lateness_ms.append((time.monotonic() - due) * 1e3)
        due = max(due, time.monotonic() - period_s)
    report.write_text(json.dumps({"fifo": fifo, "lateness_ms": lateness_ms}), encoding="utf-8")


if __name__ == "__main__":
    _measure(int(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3]))
