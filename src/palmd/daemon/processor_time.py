"""Who had the processor while a tick was late, as far as Linux tells: other programs, or a virtual machine's host."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

_STEAL = 8  # of the numbers after "cpu" in /proc/stat: what the host kept, in clock ticks, of all processors together
_WAITED = 1  # of those in schedstat: nanoseconds of waiting while others ran
_LEAST_S = 1e-3


class ProcessorTime:
    """What was kept from the thread of the loop since it was asked last; nothing where the system does not say."""

    def __init__(self, folder: Path = Path("/proc")) -> None:
        self._folder = folder
        self._waited_s, self._kept_s = self._counters()

    def forget(self) -> None:
        """Count from now on; two short reads of memory, some 30 µs."""
        self._waited_s, self._kept_s = self._counters()

    def lost(self) -> str:
        """In words what was kept from it since, each part that came to a millisecond; counts from now on."""
        waited_s, kept_s = self._waited_s, self._kept_s
        self.forget()
        parts = (
            (self._waited_s - waited_s, "it waited for a processor while other programs ran"),
            (self._kept_s - kept_s, "this virtual machine's host kept its processors"),
        )
        return " and ".join(f"{what} for {seconds * 1e3:.0f} ms" for seconds, what in parts if seconds >= _LEAST_S)

    def _counters(self) -> tuple[float, float]:
        """Seconds of waiting, and seconds that the host kept."""
        hertz = os.sysconf("SC_CLK_TCK")
        return (
            self._number("self/schedstat", lambda text: int(text.split()[_WAITED]) * 1e-9),
            self._number("stat", lambda text: int(text.split(maxsplit=_STEAL + 1)[_STEAL]) / hertz),
        )

    def _number(self, name: str, read: Callable[[str], float]) -> float:
        with suppress(OSError, ValueError, IndexError):
            return read((self._folder / name).read_text())
        return 0.0
