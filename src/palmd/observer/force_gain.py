"""Correlated errors of a pad's forces: a drifting gain, and hysteresis behind a changing force. Pure.

Readings share these errors; averaging does not reduce them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palmd.events import FloatArray

# Correlation time of a pad's gain (s), 1σ of the hysteresis relative to the force, its correlation time (s), and the
# spacing of knots (s).
DRIFT_S, HYSTERESIS, HYSTERESIS_S, KNOT_S = 20.0, 0.02, 3.0, 2.0


def modes_at(t: FloatArray, spans: Sequence[tuple[float, float]], std: float) -> FloatArray:
    """(n, modes): relative change of the force at t (s) by each independent mode, at 1σ, of a gain error of `std`.

    Gain errors are defined at knots in `spans` (s), which contain all t, and interpolated linearly.
    """
    knots = np.concatenate([np.linspace(a, b, math.ceil((b - a) / KNOT_S) + 1) for a, b in spans])
    interval = np.abs(knots[:, None] - knots)
    covariance = std**2 * np.exp(-interval / DRIFT_S) + HYSTERESIS**2 * np.exp(-interval / HYSTERESIS_S)
    left = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 2)
    share = (t - knots[left]) / (knots[left + 1] - knots[left])
    between: FloatArray = np.zeros((len(t), len(knots)))
    each = np.arange(len(t))
    between[each, left], between[each, left + 1] = 1.0 - share, share
    modes: FloatArray = between @ np.linalg.cholesky(covariance)
    return modes


def hysteresis_position(forces: FloatArray) -> FloatArray:
    """Position within the hysteresis for each force (N) of a contact: −1 while the force rises, 1 while it falls."""
    position, reported = np.zeros(len(forces)), 0.0
    for i, force in enumerate(forces.tolist()):
        reported = min(max(reported, force * (1.0 - HYSTERESIS)), force * (1.0 + HYSTERESIS))
        position[i] = (reported / force - 1.0) / HYSTERESIS
    return position
