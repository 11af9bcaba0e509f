"""palmd's own filter: the generated C of one filter of the bank, bound to arrays."""

# ruff: noqa: N802 -- matrices keep their capital letters
from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.model import shape_map
from palmd.model.compiled import Library, load
from palmd.model.kernels import single
from palmd.system.mechanism import PALMS
from tools.studies.peers.task import PeerReading, PeerStart, radii


def library() -> Library:
    """`predict`, `update_s1` and `update_s2` of the shape map for one filter; compiles the first time."""
    updates = [shape_map.update_function(name, pad) for name, pad in zip(shape_map.UPDATES, PALMS, strict=True)]
    return load("shape_map_single", lambda: map(single, (shape_map.predict_function(), *updates)))


class GeneratedFilter:
    """The extended Kalman filter of `model.shape_map`; `gate` as in the bank, in innovation²/variance."""

    def __init__(self, kernels: Library, start: PeerStart, gate: float = math.inf):
        n = shape_map.N
        self._x, self._P = [start.x.copy(), np.zeros(n)], [start.P.copy(), np.zeros((n, n))]
        self._side = 0  # kernels write into the other side's arrays, which then become the current ones
        self._u, self._z = np.zeros(shape_map.PREDICTION_INPUTS), np.zeros(shape_map.UPDATE_INPUTS)
        self._z[2:4] = gate, 1.0  # each reading by itself
        outcome = np.zeros(2)
        sides = [(self._x[a], self._P[a], self._x[1 - a], self._P[1 - a]) for a in range(2)]
        self._predict = [kernels.bind("predict", [x, P, self._u], [x2, P2]) for x, P, x2, P2 in sides]
        self._update = {
            pad: [kernels.bind(name, [x, P, self._z], [x2, P2, outcome]) for x, P, x2, P2 in sides]
            for name, pad in zip(shape_map.UPDATES, PALMS, strict=True)
        }

    @property
    def x(self) -> FloatArray:
        """The state, as `shape_map.Z`."""
        return self._x[self._side]

    @property
    def P(self) -> FloatArray:
        """Its covariance."""
        return self._P[self._side]

    def step(self, reading: PeerReading) -> bool:
        """Predict to the reading and fuse it."""
        for u in reading.moves:
            self._u[:] = u
            self._predict[self._side]()
            self._side = 1 - self._side
        z, palms = self._z, reading.palms
        z[:2], z[4:] = (reading.value, reading.variance), palms[:2]
        self._update[reading.pad][self._side]()
        self._side = 1 - self._side
        return True

    def radii(self, reading: PeerReading) -> FloatArray:
        """(r1, r2) (m)."""
        return radii(self.x, reading)

    def outline(self) -> FloatArray:
        """Coefficients of h (m)."""
        return self.x[shape_map.Z.SHAPE :]
