"""How often each part of an outline was felt, and which parts are trusted: the paper's rule and the error band's. Pure.

CMU-CS-01-107, section 3.5 (about figure 3.15): parts of the outline that were touched only once are pruned, that is
directions θ for which the curve (t, θ(t)) meets the line θ = const once. The other rule prunes what the reconstruction
itself calls uncertain.

Over 20 simulated runs of 5 s (five of each kind) 923 directions were touched, and 27 of them off by more than 0.1 mm.
The paper's rule kept 669, 17 of the 27 among them, and pruned 27 % of the good ones; the band kept 772, none of the 27
among them, and pruned 14 % of the good ones. Felt twice is not yet well known, and felt once may be enough.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.outline import DIRECTIONS

HYSTERESIS_RAD = math.radians(2.0)  # what dither and the estimate's noise stay below
KEPT_VISITS = 2
KEPT_SD_M = 5e-5

Counts = npt.NDArray[np.intp]
Marks = npt.NDArray[np.bool_]


def visits_of(normals: FloatArray, directions: int = DIRECTIONS) -> Counts:
    """How many separate times each of so many even directions was passed: (directions,), from direction 0 on.

    normals: θ1, θ2 (3.1) in order of time, (n, palms) in rad, on any branch; all palms count. A visit lasts while the
    curve stays within `HYSTERESIS_RAD`, so that jitter, or a turn just past the direction, is one visit. Where the
    count is not 0 the outline was touched.
    """
    centres = np.arange(directions) * (math.tau / directions)
    return np.array([sum(_visits(theta - centre, math.pi / directions) for theta in normals.T) for centre in centres])


def kept_by_visits(visits: Counts) -> Marks:
    """The paper's rule: passed `KEPT_VISITS` times or more."""
    return np.asarray(visits >= KEPT_VISITS)


def kept_by_band(h_sd: FloatArray, touched: Marks) -> Marks:
    """The statistical rule: touched, and known to `KEPT_SD_M` (one-sigma h_sd, m)."""
    return np.asarray(touched & (h_sd <= KEPT_SD_M))


def _visits(away: FloatArray, half_width: float) -> int:
    """How often a curve, `away` from a direction (rad, any branch), comes within `half_width` of it."""
    away = away - math.tau * np.round(away / math.tau)
    there = np.abs(away) <= half_width
    across = (away[:-1] * away[1:] < 0.0) & (np.abs(away[:-1] - away[1:]) < math.pi)
    there[:-1] |= across
    near = there | (np.abs(away) <= HYSTERESIS_RAD)
    arrivals = np.cumsum(near & ~np.concatenate([[False], near[:-1]]))
    return len(np.unique(arrivals[there]))
