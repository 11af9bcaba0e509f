"""What a run holds, by the module that asked for it, and which of them holds more and more."""

from __future__ import annotations

import gc
import tracemalloc
from dataclasses import dataclass
from pathlib import Path

import palmd
from palmd.lab.soak_slopes import growth, slope

LEAK_KB_H = 50.0
"""Half of what must be found."""

EVERY_S = 10.0
WARM_UP_PART = 0.25
_OURS = str(Path(palmd.__file__).parent)
_WATCHERS = (f"{_OURS}/lab/", f"{_OURS}/rig/", tracemalloc.__file__)


@dataclass(frozen=True, slots=True)
class Leak:
    """An owner, a file of palmd or a library, that held so much (bytes) in the end, and by how much more an hour."""

    owner: str
    held: int
    kb_h: float

    def __str__(self) -> str:
        return f"{self.owner} holds {self.held / 1e3:.1f} kB, {self.kb_h:+.0f} kB/h"


class Holdings:
    """What has been asked for since it was made and is still held; call `sample` at moments that are alike.

    The emulated rig's and the watchers' own memory is left out.
    """

    def __init__(self) -> None:
        """Begins to trace all that is asked for, which slows the interpreter down."""
        tracemalloc.start()
        self._t: list[float] = []
        self._held: dict[str, list[int]] = {}

    def sample(self, t: float) -> None:
        """What is held at `t` (s)."""
        gc.collect()
        for owner in self._held.values():
            owner.append(0)
        self._t.append(t)
        for each in tracemalloc.take_snapshot().statistics("filename"):
            name = each.traceback[0].filename
            if not name.startswith(_WATCHERS):
                owner = self._held.setdefault(name.removeprefix(f"{_OURS}/"), [0] * len(self._t))
                owner[-1] = each.size

    def close(self) -> None:
        """Trace no longer."""
        tracemalloc.stop()

    def leaks(self) -> list[Leak]:
        """Who holds more and more, the worst first: robust slope and what was held least agree, after a warm-up."""
        begin = round(WARM_UP_PART * len(self._t))
        found = []
        for owner, held in self._held.items():
            kb_h = slope(self._t[begin:], held[begin:]) * 3.6
            if kb_h > LEAK_KB_H and growth(held[begin:]) > 0.0:
                found.append(Leak(owner, held[-1], kb_h))
        return sorted(found, key=lambda leak: -leak.kb_h)

    def together(self) -> tuple[float, float]:
        """What all hold in the end (kB), and by how much more an hour (kB/h)."""
        begin = round(WARM_UP_PART * len(self._t))
        total = [sum(each) for each in zip(*self._held.values(), strict=True)]
        return (total[-1] / 1e3, slope(self._t[begin:], total[begin:]) * 3.6) if total else (0.0, 0.0)
