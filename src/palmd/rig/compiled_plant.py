"""What `plant.c` computes, a step of a smooth body on flat palms, to the bit as its twin in Python, `plant.Plant`."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from palmd.model.compiled import load
from palmd.rig.shapes import Support, SupportFunction

_STEP = struct.Struct("=50d")
_SHAKING = 3
_BODY = struct.Struct("=36d")  # a step's beginning

Pads = Sequence[tuple[float, float, float]]
Scene = Mapping[str, float | tuple[float, ...]]


def _doubles(*names: str) -> list[tuple[str, type]]:
    return [(name, ctypes.c_double) for name in names]


class _Scene(ctypes.Structure):
    _fields_ = (
        ("table", ctypes.c_void_p),
        *_doubles("rho2", "mu", "dither", "damping", "friction1", "friction2", "gravity", "shake"),
        ("shaking_hz", ctypes.c_double * _SHAKING),
        *_doubles("travel"),
        ("base", ctypes.c_double * 2),
        *_doubles("drift_rate", "soft_blow", "parting", "lost_distance"),
        ("pads", ctypes.c_double * 6),
        *((name, ctypes.c_long) for name in ("arc", "bowed")),
    )


def backend() -> str:
    """What steps the plant: compiled C, or Python where there is no compiler."""
    return "python" if _advance() is None else "c"


class CompiledStep:
    """One step of a body on its pads, in memory of its own; what is pickled or copied gets another."""

    def __init__(self, advance: Callable[[int, int], None], support: Support, pads: Pads, scene: Scene) -> None:
        self._made_of = support, pads, scene
        self._advance, self._table = advance, np.array(support.table)
        numbers = (ctypes.c_double * 6)(*(number for pad in pads for number in pad))
        self._scene = _Scene(table=self._table.ctypes.data, pads=numbers, **scene)
        self._memory = ctypes.create_string_buffer(_STEP.size)
        self._scene_at, self._memory_at = ctypes.addressof(self._scene), ctypes.addressof(self._memory)

    def __call__(self, *numbers: float) -> tuple[float, ...]:
        """Takes the numbers of `plant.c`'s Step, and returns those of its Body after it."""
        _STEP.pack_into(self._memory, 0, *numbers)
        self._advance(self._scene_at, self._memory_at)
        return _BODY.unpack_from(self._memory)

    def __reduce__(self) -> tuple[Callable[..., CompiledStep | None], tuple[Support, Pads, Scene]]:
        return step_of, self._made_of


def step_of(support: SupportFunction, pads: Pads, scene: Scene) -> CompiledStep | None:
    """Of a body on `pads`, each (sagitta, standoff, reach) in m; None where the twin has to do.

    `scene`: by the names of `plant.c`'s Scene.
    """
    advance = _advance()
    return None if advance is None or not isinstance(support, Support) else CompiledStep(advance, support, pads, scene)


@cache
def _advance() -> Callable[[int, int], None] | None:
    path = load("plant", list, written=[str(Path(__file__).with_name("plant.c"))]).path
    if path is None:
        return None
    function = ctypes.CDLL(str(path)).plant_advance
    function.argtypes, function.restype = (ctypes.c_void_p, ctypes.c_void_p), None
    return function
