"""What used the processor while a tick was late, as reported by Linux: other programs, or a virtual machine's host."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

_STEAL = 8  # index after "cpu" in /proc/stat: time taken by the host, in clock ticks, summed over all processors
_WAITED = 1  # index in schedstat: nanoseconds of waiting while others ran
_LEAST_S = 1e-3


class ProcessorTime:
    """Processor time that the loop's thread was denied since the last query; 0 where the system does not report it."""

    def __init__(self, folder: Path = Path("/proc")) -> None:
        self._folder = folder
        self._waited_s, self._stolen_s = self._counters()

    def forget(self) -> None:
        """Restart counting; two short reads of memory, about 30 µs."""
        self._waited_s, self._stolen_s = self._counters()

    def lost(self) -> str:
        """Describe the causes since then that took at least 1 ms each; restarts counting."""
        waited_s, stolen_s = self._waited_s, self._stolen_s
        self.forget()
        parts = (
            (self._waited_s - waited_s, "it waited for a processor while other programs ran"),
            (self._stolen_s - stolen_s, "this virtual machine's host withheld its processors"),
        )
        return " and ".join(f"{what} for {seconds * 1e3:.0f} ms" for seconds, what in parts if seconds >= _LEAST_S)

    def _counters(self) -> tuple[float, float]:
        """Seconds of waiting, and seconds taken by the host."""
        hertz = os.sysconf("SC_CLK_TCK")
        return (
            self._number("self/schedstat", lambda text: int(text.split()[_WAITED]) * 1e-9),
            self._number("stat", lambda text: int(text.split(maxsplit=_STEAL + 1)[_STEAL]) / hertz),
        )

    def _number(self, name: str, read: Callable[[str], float]) -> float:
        with suppress(OSError, ValueError, IndexError):
            return read((self._folder / name).read_text())
        return 0.0
