"""The generated kernels applied to many instants at once, with arrays in NumPy's order."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import three_palms
from palmd.model.compiled import LANES, Library
from palmd.model.spherical import count
from palmd.model.three_palms import PALM_INPUTS, RIG_INPUTS
from palmd.system.three_palms import PalmPlanes
from palmd.system.vibration import VibrationLaw

CHUNK = 8 * LANES
"""Instants computed at once; their results stay in the processor's cache."""


class BlockKernel:
    """A block kernel, called in a loop for `CHUNK` instants at a time.

    each: sizes of the inputs that differ between instants; shared: sizes of those common to all; shapes: of the
    outputs, (rows, columns) or (rows,). Input matrices are column-major, as in CasADi.
    """

    def __init__(
        self, library: Library, name: str, each: Sequence[int], shared: Sequence[int], shapes: Sequence[tuple[int, ...]]
    ) -> None:
        self._inputs: list[FloatArray] = [np.zeros((CHUNK, size)) for size in each]
        self._shared: list[FloatArray] = [np.zeros(size) for size in shared]
        self._outputs: list[FloatArray] = [np.zeros((CHUNK, *shape[::-1])) for shape in shapes]
        self._call = library.bind(name, [*self._inputs, *self._shared], self._outputs)

    def __call__(self, each: Sequence[FloatArray], shared: Sequence[FloatArray | float]) -> list[FloatArray]:
        """Outputs (T, *shape) for inputs (T, size) and the shared inputs."""
        total = len(each[0])
        for common, given in zip(self._shared, shared, strict=True):
            common[:] = given
        results: list[FloatArray] = [np.empty((total, *buffer.shape[1:])) for buffer in self._outputs]
        for begin in range(0, total, CHUNK):
            end = min(begin + CHUNK, total)
            for buffer, value in zip(self._inputs, each, strict=True):
                buffer[: end - begin] = value[begin:end]
            self._call(-(-(end - begin) // LANES) * LANES)
            for result, buffer in zip(results, self._outputs, strict=True):
                result[begin:end] = buffer[: end - begin]
        return [np.swapaxes(result, 1, -1) if result.ndim == 3 else result for result in results]


def by_columns(R: FloatArray) -> FloatArray:
    """(T, 9) column-major copies of matrices (T, 3, 3), as kernels expect them."""
    return np.ascontiguousarray(np.swapaxes(R, 1, 2)).reshape(-1, 9)


def palm_inputs(palms: PalmPlanes) -> FloatArray:
    """(T, `PALM_INPUTS`) kernel inputs of the palms."""
    kinds = (palms.normal, palms.normal_rate, palms.normal_acceleration, palms.spin)
    return np.concatenate([kind.reshape(-1, 9) for kind in kinds], axis=1)


def reading_geometry(palms: PalmPlanes, pad: npt.NDArray[np.int64]) -> FloatArray:
    """(T, 24) kernel inputs of readings of `pad` (T,), 0 to 2: normals, reciprocal vectors and the pad's axes."""
    inverse = np.linalg.inv(palms.normal)  # rows of N are normals
    rows = np.arange(len(pad))
    turn = (pad[:, None] + np.arange(3)) % 3
    normals = palms.normal[rows[:, None], turn]
    reciprocals = np.swapaxes(inverse, 1, 2)[rows[:, None], turn]
    return np.concatenate(
        [normals.reshape(-1, 9), reciprocals.reshape(-1, 9), palms.axis_a[rows, pad], palms.axis_b[rows, pad]], axis=1
    )


@cache
def reading(order: int, law: VibrationLaw = "sign_pairs") -> BlockKernel:
    """(R, geometry; c) → (y, ∂y/∂δ, ∂y/∂c)."""
    n = count(order)
    return BlockKernel(three_palms.library(order, law), "reading_block", (9, 24), (n,), [(2,), (2, 3), (2, n)])


@cache
def driven(law: VibrationLaw = "sign_pairs") -> BlockKernel:
    """(state, palms, contacts; constants, rig) → (rates, ∂/∂state, ∂/∂constants)."""
    shapes = [(6,), (6, 6), (6, 4)]
    return BlockKernel(three_palms.driven_library(law), "driven_block", (6, PALM_INPUTS, 18), (4, RIG_INPUTS), shapes)
