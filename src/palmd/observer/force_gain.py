"""What a pad's forces are off by all along: a gain that wanders, and a play that falls behind a changing force. Pure.

Readings share it, and no number of them averages it out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palmd.events import FloatArray

# How soon a pad's gain drifts, what it falls behind a changing force by (one sigma), and how soon that turns round.
DRIFT_S, BEHIND, BEHIND_S, KNOT_S = 20.0, 0.02, 3.0, 2.0


def modes_at(t: FloatArray, spans: Sequence[tuple[float, float]], std: float) -> FloatArray:
    """(n, modes): the share by which each mode of a gain that is off by `std` moves the force at t (s).

    Gains are told at knots in `spans` (s), to which all t belong; one sigma each, independent of each other.
    """
    knots = np.concatenate([np.linspace(a, b, math.ceil((b - a) / KNOT_S) + 1) for a, b in spans])
    apart = np.abs(knots[:, None] - knots)
    covariance = std**2 * np.exp(-apart / DRIFT_S) + BEHIND**2 * np.exp(-apart / BEHIND_S)
    left = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 2)
    share = (t - knots[left]) / (knots[left + 1] - knots[left])
    between: FloatArray = np.zeros((len(t), len(knots)))
    each = np.arange(len(t))
    between[each, left], between[each, left + 1] = 1.0 - share, share
    modes: FloatArray = between @ np.linalg.cholesky(covariance)
    return modes


def place_in_play(felt: FloatArray) -> FloatArray:
    """Where in a play of `BEHIND` a pad is at each force of a touch (N): −1 as it rises, 1 as it falls."""
    place, told = np.zeros(len(felt)), 0.0
    for i, force in enumerate(felt.tolist()):
        told = min(max(told, force * (1.0 - BEHIND)), force * (1.0 + BEHIND))
        place[i] = (told / force - 1.0) / BEHIND
    return place
