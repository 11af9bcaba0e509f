"""What `plant.c` computes, a step of a smooth body on flat palms, to the bit as its twin in Python, `plant.Plant`."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import numpy as np

from palmd.model.compiled import load
from palmd.rig.shapes import Support, SupportFunction

_STEP = struct.Struct("=50d")
_SHAKING = 3
_BODY = struct.Struct("=36d")  # a step's beginning

Step = Callable[..., tuple[float, ...]]
"""Takes the numbers of `plant.c`'s Step, and returns those of its Body after it."""


def _doubles(*names: str) -> list[tuple[str, type]]:
    return [(name, ctypes.c_double) for name in names]


class _Scene(ctypes.Structure):
    _fields_ = (
        ("table", ctypes.c_void_p),
        *_doubles("rho2", "mu", "dither", "damping", "friction1", "friction2", "gravity", "shake"),
        ("shaking_hz", ctypes.c_double * _SHAKING),
        *_doubles("travel"),
        ("base", ctypes.c_double * 2),
        *_doubles("drift_rate", "coulomb_slip", "soft_blow", "parting", "lost_distance"),
        ("pads", ctypes.c_double * 6),
        *((name, ctypes.c_long) for name in ("coulomb", "arc", "bowed")),
    )


def backend() -> str:
    """What steps the plant: compiled C, or Python where there is no compiler."""
    return "python" if _advance() is None else "c"


def step_of(
    support: SupportFunction, pads: Iterable[tuple[float, float, float]], **scene: float | tuple[float, ...]
) -> Step | None:
    """Of a body on `pads`, each (sagitta, standoff, reach) in m; None where the twin has to do.

    `scene`: by the names of `plant.c`'s Scene.
    """
    advance = _advance()
    if advance is None or not isinstance(support, Support):
        return None
    table = np.array(support.table)
    numbers = (ctypes.c_double * 6)(*(number for pad in pads for number in pad))
    held, memory = _Scene(table=table.ctypes.data, pads=numbers, **scene), ctypes.create_string_buffer(_STEP.size)
    scene_at, memory_at = ctypes.addressof(held), ctypes.addressof(memory)

    def step(*numbers: float, _held: object = (table, held)) -> tuple[float, ...]:
        _STEP.pack_into(memory, 0, *numbers)
        advance(scene_at, memory_at)
        return _BODY.unpack_from(memory)

    return step


@cache
def _advance() -> Callable[[int, int], None] | None:
    path = load("plant", list, written=[str(Path(__file__).with_name("plant.c"))]).path
    if path is None:
        return None
    function = ctypes.CDLL(str(path)).plant_advance
    function.argtypes, function.restype = (ctypes.c_void_p, ctypes.c_void_p), None
    return function
