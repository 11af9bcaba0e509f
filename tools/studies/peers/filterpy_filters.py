"""filterpy's extended and unscented Kalman filters on palmd's model; needs the extra `studies`."""

# ruff: noqa: N802, N806 -- matrices keep their capital letters
from __future__ import annotations

import numpy as np
from filterpy.kalman import (  # type: ignore[import-untyped]
    ExtendedKalmanFilter,
)

from palmd.events import FloatArray
from palmd.model import shape_map
from tools.studies.peers.functions import Q_DIAGONAL, Functions, array
from tools.studies.peers.task import PeerReading, PeerStart, radii

ALPHA, BETA, KAPPA = 1.0, 2.0, 0.0
"""Of Merwe's sigma points: the usual α of 0.1 or less weighs the centre by −2000 with 21 states, and P is soon lost."""


class _OnShapeMap:
    """What both have in common."""

    def __init__(self, model: Functions):
        self._model = model

    def radii(self, reading: PeerReading) -> FloatArray:
        """(r1, r2) (m)."""
        return radii(self.x, reading)

    def outline(self) -> FloatArray:
        """Coefficients of h (m)."""
        return self.x[shape_map.Z.SHAPE :]

    @property
    def x(self) -> FloatArray:
        """The state, as `shape_map.Z`."""
        raise NotImplementedError


class FilterpyExtended(_OnShapeMap):
    """`filterpy.kalman.ExtendedKalmanFilter`, its `predict_x` overridden as its documentation asks for."""

    def __init__(self, model: Functions, start: PeerStart):
        super().__init__(model)
        self._filter = ekf = ExtendedKalmanFilter(dim_x=shape_map.N, dim_z=1)
        ekf.x, ekf.P, ekf.Q = start.x.copy(), start.P.copy(), np.zeros((shape_map.N,) * 2)
        ekf.predict_x = self._predict_x

    @property
    def x(self) -> FloatArray:
        return np.asarray(self._filter.x)

    @property
    def P(self) -> FloatArray:
        """The state's covariance."""
        return np.asarray(self._filter.P)

    def step(self, reading: PeerReading) -> bool:
        """Predict to the reading and fuse it."""
        ekf, model, at = self._filter, self._model, reading.pad - 1
        for u in reading.moves:
            ekf.Q[0, 0], ekf.Q[1, 1] = (q * u[0] for q in Q_DIAGONAL)
            ekf.predict(u)
        ekf.update(
            np.array([reading.value]),
            lambda x: model.row[at](x, reading.palms).full(),
            lambda x: array(model.see[at](x, reading.palms)),
            R=reading.variance,
        )
        return True

    def _predict_x(self, u: FloatArray) -> None:
        moved, F = self._model.transition(self._filter.x, u)
        self._filter.x, self._filter.F = array(moved), F.full()
