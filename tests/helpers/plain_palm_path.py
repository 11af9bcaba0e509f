"""NumPy version of `model/palm_path.c`; see `palmd.observer.palm_path.Smoothing`."""

import numpy as np

from palmd.events import FloatArray
from palmd.observer.palm_path import _FIRST


def smoothed_plainly(dt: FloatArray, drift: FloatArray, measured: FloatArray, sd: FloatArray) -> FloatArray:
    """The states that `Smoothing` returns."""
    transitions = np.tile(np.eye(3), (len(dt), 1, 1))
    transitions[:, 0, 1] = transitions[:, 1, 2] = dt
    transitions[:, 0, 2] = dt**2 / 2
    x, x_pred = np.zeros_like(measured), np.zeros_like(measured)
    P, P_pred = np.zeros((len(measured), 3, 3)), np.zeros((len(measured), 3, 3))
    x_pred[0, 0], P_pred[0] = measured[0, 0], np.diag(_FIRST)
    for k in range(len(measured)):
        if k:
            F = transitions[k - 1]
            x_pred[k] = F @ x[k - 1]
            P_pred[k] = F @ P[k - 1] @ F.T + drift[k - 1]
        x[k], P[k] = _fused(x_pred[k], P_pred[k], measured[k], sd)
    gains = np.linalg.solve(P_pred[1:], transitions @ P[:-1]).swapaxes(1, 2)
    for k in range(len(measured) - 2, -1, -1):
        x[k] += gains[k] @ (x[k + 1] - x_pred[k + 1])
    return x


def _fused(x: FloatArray, P: FloatArray, measured: FloatArray, sd: FloatArray) -> tuple[FloatArray, FloatArray]:
    for row in np.flatnonzero(~np.isnan(measured[:, 0])):
        spread = P[row, row] + sd[row] ** 2
        gain = P[:, row] / spread
        x = x + gain[:, None] * (measured[row] - x[row])
        P = P - gain[:, None] * gain * spread
    return x, P
