"""What a daemon holds, by the module whose objects hold it, and which of them holds more and more."""

from __future__ import annotations

import gc
import sys
import types
from array import array
from dataclasses import dataclass

from tools.studies.soak_slopes import growth, slope

LEAK_KB_H = 50.0
"""Half of what must be found."""

LEAK_BLOCKS_H, COME_AND_GO = 1000.0, 150.0
"""Of the interpreter's, all together, for what nothing of the daemon's holds leaks as well; and so many come and go."""

EVERY_S = 10.0
WARM_UP_PART = 0.25
EVERYTHING = "the interpreter"
_HOUR_S = 3600.0
_NOT_HELD = (type, types.ModuleType, types.FunctionType, types.MethodType, types.BuiltinFunctionType, types.CodeType)
_WATCHERS = ("tools.studies", "palmd.rig")


@dataclass(frozen=True, slots=True)
class Leak:
    """An owner that held so much in the end, and by how much more an hour; `unit` is kB or blocks."""

    owner: str
    held: float
    per_hour: float
    unit: str

    def __str__(self) -> str:
        return f"{self.owner} holds {self.held:.1f} {self.unit}, {self.per_hour:+.0f} {self.unit}/h"


class Holdings:
    """What is held from a root on; call `sample` at moments that are alike. The emulated rig's own is left out."""

    def __init__(self) -> None:
        self._t = array("d")  # an array of numbers is one block, however long
        self._held: dict[str, array[float]] = {}
        self._blocks = array("d")

    def sample(self, root: object, t: float) -> None:
        """What is held at `t` (s)."""
        gc.collect()
        self._blocks.append(sys.getallocatedblocks())
        self._t.append(t)
        now = held_by(root)
        for owner in {*self._held, *now}:
            held = self._held.setdefault(owner, array("d", bytes(8 * (len(self._t) - 1))))
            held.append(now.get(owner, 0) / 1e3)

    def leaks(self) -> list[Leak]:
        """Who holds more and more, the worst first: robust slope and what was held least agree, after a warm-up."""
        judged = [(owner, kb, LEAK_KB_H, 0.0, "kB") for owner, kb in self._held.items()]
        judged.append((EVERYTHING, self._blocks, LEAK_BLOCKS_H, COME_AND_GO, "blocks"))
        found = [Leak(owner, some[-1], self._per_hour(some), unit) for owner, some, most, noise, unit in judged
                 if self._per_hour(some) > most and growth(self._warm(some)) > noise]  # fmt: skip
        return sorted(found, key=lambda leak: -leak.per_hour)

    def together(self) -> Leak:
        """All owners as one (kB)."""
        total = array("d", (sum(each) for each in zip(*self._held.values(), strict=True)))
        return Leak("the daemon", total[-1], self._per_hour(total), "kB")

    def _per_hour(self, some: array[float]) -> float:
        return slope(self._warm(self._t), self._warm(some)) * _HOUR_S

    def _warm(self, some: array[float]) -> list[float]:
        return some[round(WARM_UP_PART * len(some)) :].tolist()


def held_by(root: object) -> dict[str, int]:
    """How many bytes are held from a root on, by the module of the nearest of palmd's own objects that holds them."""
    sizes: dict[str, int] = {}
    seen: set[int] = set()
    found: list[tuple[object, str]] = [(root, type(root).__module__)]
    while found:
        each, owner = found.pop()
        if id(each) in seen or isinstance(each, _NOT_HELD):
            continue
        seen.add(id(each))
        kind = type(each)
        module = next(base.__module__ for base in kind.__mro__ if not base.__module__.startswith(_WATCHERS))
        if module == "builtins" != kind.__module__:
            continue  # a watcher's own
        if module.startswith("palmd."):
            owner = module
        sizes[owner] = sizes.get(owner, 0) + sys.getsizeof(each)
        found += [(held, owner) for held in gc.get_referents(each)]
    return sizes
