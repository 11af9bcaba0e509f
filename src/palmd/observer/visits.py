"""How often each part of an outline was touched, and which parts are kept: by visits, or by the error band. Pure.

CMU-CS-01-107, section 3.5 (about figure 3.15): parts of the outline that were touched only once are pruned, that is,
directions θ for which the curve (t, θ(t)) meets the line θ = const once. The other rule prunes directions with a wide
error band.

Over 20 simulated runs of 5 s (five of each kind) 923 directions were touched, and 27 of them had errors above 0.1 mm.
The paper's rule kept 669, 17 of the 27 among them, and pruned 27 % of the good ones; the band kept 772, none of the 27
among them, and pruned 14 % of the good ones. Two touches do not ensure a small error, and one may be enough.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.outline import DIRECTIONS

HYSTERESIS_RAD = math.radians(2.0)  # above dither and the estimate's noise
KEPT_VISITS = 2
KEPT_SD_M = 5e-5

Counts = npt.NDArray[np.intp]
Marks = npt.NDArray[np.bool_]


def visits_of(normals: FloatArray, directions: int = DIRECTIONS) -> Counts:
    """How often each of `directions` evenly spaced directions was visited: (directions,), from direction 0 on.

    normals: θ1, θ2 (3.1) in order of time, (n, palms) in rad, on any branch; all palms count. A visit lasts while the
    curve stays within `HYSTERESIS_RAD`, so that jitter, or a reversal just past the direction, is one visit. The
    outline was touched where the count is not 0.
    """
    counts: Counts = np.sum([_visits(theta / (math.tau / directions), directions) for theta in normals.T], axis=0)
    return counts


def kept_by_visits(visits: Counts) -> Marks:
    """The paper's rule: passed `KEPT_VISITS` times or more."""
    return np.asarray(visits >= KEPT_VISITS)


def kept_by_band(h_sd: FloatArray, touched: Marks) -> Marks:
    """The statistical rule: touched, and 1σ h_sd (m) at most `KEPT_SD_M`."""
    return np.asarray(touched & (h_sd <= KEPT_SD_M))


def _visits(at: FloatArray, directions: int) -> Counts:
    """How often a curve (in directions from direction 0, any branch) comes within half a unit of each direction."""
    hysteresis = HYSTERESIS_RAD * directions / math.tau
    about = np.round(at)[:, None] + np.arange(-math.ceil(hysteresis), math.ceil(hysteresis) + 1)
    away = np.abs(at[:, None] - about)
    near = away <= max(hysteresis, 0.5)
    before, passed = _passed(at, directions)
    node = np.concatenate([np.nonzero(near)[0], before])
    direction = np.concatenate([about[near], passed]).astype(np.intp) % directions
    within = np.concatenate([away[near] <= 0.5, np.ones(len(passed), dtype=np.bool_)])
    # by direction and then by time: consecutive nodes are one visit
    place, which = np.unique(direction * (len(at) + 1) + node, return_inverse=True)
    visit = np.cumsum(np.diff(place, prepend=-2) > 1)
    of_visit = np.zeros(visit[-1] + 1, dtype=np.intp)
    of_visit[visit] = place // (len(at) + 1)
    arrived = np.unique(visit[which[within]])
    return np.bincount(of_visit[arrived], minlength=directions)


def _passed(at: FloatArray, directions: int) -> tuple[Counts, FloatArray]:
    """The directions strictly between each node and the next, the shorter way round, and the nodes before them."""
    turn = np.diff(at)
    turn -= directions * np.round(turn / directions)
    low, high = np.minimum(at[:-1], at[:-1] + turn), np.maximum(at[:-1], at[:-1] + turn)
    first = np.floor(low) + 1.0
    count = np.maximum(np.ceil(high) - first, 0.0).astype(np.intp)
    node = np.repeat(np.arange(len(count)), count)
    nth = np.arange(len(node)) - np.repeat(np.cumsum(count) - count, count)
    return node, first[node] + nth
