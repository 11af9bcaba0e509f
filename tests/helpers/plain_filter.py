"""An extended Kalman filter in plain NumPy on the NumPy twin of the model."""

from __future__ import annotations

import numpy as np
from plain_shape_map import reading_row, transition

from palmd.events import FloatArray
from palmd.model import shape_map
from tools.studies.peers.task import PeerReading, PeerStart, radii


class PlainFilter:
    """x, P as a textbook has them; the covariance in Joseph's form."""

    def __init__(self, start: PeerStart):
        self.x, self.P = start.x.copy(), start.P.copy()
        self._q = np.zeros(shape_map.N)
        self._q[:2] = shape_map.Q_PSI, shape_map.Q_OMEGA0

    def step(self, reading: PeerReading) -> bool:
        """Predict to the reading and fuse it."""
        for u in reading.moves:
            self.x, F = transition(self.x, u)
            self.P = F @ self.P @ F.T + np.diag(self._q * u[0])
        phi1, phi2 = reading.palms[:2].tolist()
        seen, row = reading_row(self.x, phi1, phi2, reading.pad)
        Ph = self.P @ row
        gain = Ph / (row @ Ph + reading.variance)
        self.x = self.x + gain * (reading.value - seen)
        keep = np.eye(shape_map.N) - np.outer(gain, row)
        self.P = keep @ self.P @ keep.T + np.outer(gain, gain) * reading.variance
        return True

    def radii(self, reading: PeerReading) -> FloatArray:
        """(r1, r2) (m)."""
        return radii(self.x, reading)

    def outline(self) -> FloatArray:
        """Coefficients of h (m)."""
        return self.x[shape_map.Z.SHAPE :]
