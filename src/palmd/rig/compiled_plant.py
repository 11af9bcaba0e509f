"""What `plant.c` computes, to the bit as its twins in Python.

A step of a smooth body on flat palms, `plant.Plant`, and a run of it on palms that rock, `simulate.run_of`.
"""

from __future__ import annotations

import ctypes
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import load_written
from palmd.rig.shapes import Support, SupportFunction
from palmd.system.mechanism import JOINTS

_STEP = struct.Struct("=50d")
_SHAKING = 3
_BODY = struct.Struct("=36d")  # a step's beginning

_MOTIONS = (0.0,) * 12  # of a step: a run sets them itself
ROW = 11
"""Numbers in `plant.h`'s Row."""

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


class RockNumbers(NamedTuple):
    """One palm's `simulate.Rock`: rad, Hz and rad, and its rests (from, to) in s."""

    mean: float
    amplitude: float
    frequency: float
    phase: float
    rests: Sequence[tuple[float, float]]


class Drive(NamedTuple):
    """How both palms go: by how much (rad) they are off from that, and how late (s)."""

    rocks: Sequence[RockNumbers]
    off: Sequence[float]
    lag: float


class ContactBounds(NamedTuple):
    """What both contacts must keep to: a body's mass (kg), the least force (N), and from where to where (m)."""

    mass: float
    least: float
    low: float
    high: float


class _Rock(ctypes.Structure):
    _fields_ = (
        *_doubles("mean", "amplitude", "frequency", "phase"),
        ("rests", ctypes.c_void_p),
        ("resting", ctypes.c_long),
    )


class _Rocking(ctypes.Structure):
    _fields_ = (("rocks", _Rock * len(JOINTS)), ("off", ctypes.c_double * len(JOINTS)), *_doubles("lag"))


class _ContactBounds(ctypes.Structure):
    _fields_ = tuple(_doubles(*ContactBounds._fields))


def backend() -> str:
    """What steps the plant: compiled C, or Python where there is no compiler."""
    return "python" if _library() is None else "c"


class PackedRun:
    """A drive and bounds as C takes them, `plant.h`'s Rocking and ContactBounds, for as long as this is kept."""

    def __init__(self, drive: Drive, bounds: ContactBounds) -> None:
        self._rests = [np.array(rock.rests, dtype=np.float64).reshape(-1, 2) for rock in drive.rocks]
        rocks = [
            _Rock(*rock[:4], rests.ctypes.data, len(rests))
            for rock, rests in zip(drive.rocks, self._rests, strict=True)
        ]
        rocking = _Rocking((_Rock * len(JOINTS))(*rocks), (ctypes.c_double * len(JOINTS))(*drive.off), drive.lag)
        self.drive, self.bounds = ctypes.byref(rocking), ctypes.byref(_ContactBounds(*bounds))


class CompiledStep:
    """One step of a body on its pads, in memory of its own; what is pickled or copied gets another."""

    def __init__(self, library: ctypes.CDLL, support: Support, pads: Pads, scene: Scene) -> None:
        self._made_of = support, pads, scene
        self._library, self._table = library, np.array(support.table)
        numbers = (ctypes.c_double * 6)(*(number for pad in pads for number in pad))
        self._scene = _Scene(table=self._table.ctypes.data, pads=numbers, **scene)
        self._memory = ctypes.create_string_buffer(_STEP.size)
        self._scene_at, self._memory_at = ctypes.addressof(self._scene), ctypes.addressof(self._memory)

    def __call__(self, *numbers: float) -> tuple[float, ...]:
        """Takes the numbers of `plant.c`'s Step, and returns those of its Body after it."""
        _STEP.pack_into(self._memory, 0, *numbers)
        self._library.plant_advance(self._scene_at, self._memory_at)
        return _BODY.unpack_from(self._memory)

    def run(self, body: Sequence[float], drive: Drive, bounds: ContactBounds, dt: float, count: int) -> FloatArray:
        """Rows of `plant.c`'s Row, one before each of `count` steps of `dt` (s), from the numbers of its Body at t = 0.

        They end where a contact does not keep to what it must.
        """
        _STEP.pack_into(self._memory, 0, *body, 0.0, *_MOTIONS, dt)
        rows, packed = np.empty((count, ROW)), PackedRun(drive, bounds)
        done = self._library.plant_rock(
            self._scene_at, self._memory_at, packed.drive, packed.bounds, rows.ctypes.data, count
        )
        return rows[:done]

    def __reduce__(self) -> tuple[Callable[..., CompiledStep | None], tuple[Support, Pads, Scene]]:
        return step_of, self._made_of


def step_of(support: SupportFunction, pads: Pads, scene: Scene) -> CompiledStep | None:
    """Of a body on `pads`, each (sagitta, standoff, reach) in m; None where the twin has to do.

    `scene`: by the names of `plant.c`'s Scene.
    """
    library = _library()
    return None if library is None or not isinstance(support, Support) else CompiledStep(library, support, pads, scene)


def loaded(name: str) -> ctypes.CDLL | None:
    """The file of C of that name in this folder as a library, made again where `plant.h` changes; None: no compiler."""
    folder = Path(__file__).parent
    return load_written(f"{name}-{zlib.crc32((folder / 'plant.h').read_bytes()):08x}", folder / f"{name}.c")


@cache
def _library() -> ctypes.CDLL | None:
    library = loaded("plant")
    if library is None:
        return None
    pointer = ctypes.c_void_p
    library.plant_advance.argtypes, library.plant_advance.restype = (pointer, pointer), None
    library.plant_rock.argtypes = (*[pointer] * 5, ctypes.c_long)
    library.plant_rock.restype = ctypes.c_long
    return library
