"""The compiled plant, `plant.c`; results are bit-identical to those of its Python equivalents.

A step of a smooth body on flat palms (`plant.Plant`), and a run of it on rocking palms (`simulate.simulate_run`).
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
_BODY = struct.Struct("=36d")  # the first part of a step

_NO_MOTION = (0.0,) * 12  # the palms' motion in a step; a run sets it itself
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
    """Motion of both palms, the error of each joint angle (rad) with respect to it, and its delay (s)."""

    rocks: Sequence[RockNumbers]
    angle_errors: Sequence[float]
    lag: float


class ContactBounds(NamedTuple):
    """Bounds of both contacts: the body's mass (kg), the smallest force (N), and the range of positions (m)."""

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
    """How the plant is stepped: "c" if compiled, "python" if there is no compiler."""
    return "python" if _library() is None else "c"


class PackedRun:
    """A drive and bounds as `Rocking` and `ContactBounds` of `plant.h`; valid as long as this object exists."""

    def __init__(self, drive: Drive, bounds: ContactBounds) -> None:
        self._rests = [np.array(rock.rests, dtype=np.float64).reshape(-1, 2) for rock in drive.rocks]
        rocks = [
            _Rock(*rock[:4], rests.ctypes.data, len(rests))
            for rock, rests in zip(drive.rocks, self._rests, strict=True)
        ]
        rocking = _Rocking(
            (_Rock * len(JOINTS))(*rocks), (ctypes.c_double * len(JOINTS))(*drive.angle_errors), drive.lag
        )
        self.drive, self.bounds = ctypes.byref(rocking), ctypes.byref(_ContactBounds(*bounds))


class CompiledStep:
    """One step of a body on its pads, with its own memory, also after pickling or copying."""

    def __init__(self, library: ctypes.CDLL, support: Support, pads: Pads, scene: Scene) -> None:
        self._arguments = support, pads, scene
        self._library, self._table = library, np.array(support.table)
        numbers = (ctypes.c_double * 6)(*(number for pad in pads for number in pad))
        self._scene = _Scene(table=self._table.ctypes.data, pads=numbers, **scene)
        self._memory = ctypes.create_string_buffer(_STEP.size)
        self._scene_address, self._memory_address = ctypes.addressof(self._scene), ctypes.addressof(self._memory)

    def __call__(self, *numbers: float) -> tuple[float, ...]:
        """Take the numbers of `Step` in `plant.c`, and return those of its `Body` after the step."""
        _STEP.pack_into(self._memory, 0, *numbers)
        self._library.plant_advance(self._scene_address, self._memory_address)
        return _BODY.unpack_from(self._memory)

    def run(self, body: Sequence[float], drive: Drive, bounds: ContactBounds, dt: float, count: int) -> FloatArray:
        """Rows as `Row` in `plant.h`, one before each of `count` steps of `dt` (s), from a `Body` in `plant.c` at t 0.

        They end where a contact violates its bounds.
        """
        _STEP.pack_into(self._memory, 0, *body, 0.0, *_NO_MOTION, dt)
        rows, packed = np.empty((count, ROW)), PackedRun(drive, bounds)
        row_count = self._library.plant_rock(
            self._scene_address, self._memory_address, packed.drive, packed.bounds, rows.ctypes.data, count
        )
        return rows[:row_count]

    def __reduce__(self) -> tuple[Callable[..., CompiledStep | None], tuple[Support, Pads, Scene]]:
        return step_of, self._arguments


def step_of(support: SupportFunction, pads: Pads, scene: Scene) -> CompiledStep | None:
    """The compiled step of a body on `pads`, each (sagitta, standoff, reach) in m; None if Python must be used.

    `scene`: by the names of `Scene` in `plant.c`.
    """
    library = _library()
    return None if library is None or not isinstance(support, Support) else CompiledStep(library, support, pads, scene)


def load_library(name: str) -> ctypes.CDLL | None:
    """The library of a C file in this folder, rebuilt if `plant.h` changes; None without a compiler."""
    folder = Path(__file__).parent
    return load_written(f"{name}-{zlib.crc32((folder / 'plant.h').read_bytes()):08x}", folder / f"{name}.c")


@cache
def _library() -> ctypes.CDLL | None:
    library = load_library("plant")
    if library is None:
        return None
    pointer = ctypes.c_void_p
    library.plant_advance.argtypes, library.plant_advance.restype = (pointer, pointer), None
    library.plant_rock.argtypes = (*[pointer] * 5, ctypes.c_long)
    library.plant_rock.restype = ctypes.c_long
    return library
