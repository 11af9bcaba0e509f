"""What the paper's observability codistributions are worth in numbers: rank and conditioning, whatever the units.

Two scalings make the singular values free of units. Lengths are counted in typical radii ℓ and times in √(ℓ/g), the
scales that an object between palms brings along; and each differential is scaled to length 1, since how large a
function is says nothing about what it tells apart from the others. So σ lies between 0 and √n: 0 when one direction of
the state cannot be told, 1 throughout if each function told one state and no other. Noise plays no part here; what
readings tell in spite of it is the business of `observer/observability.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from tools.studies.equations.paper import CASES, POINT, Case, codistribution

LENGTH_M = 0.02
GRAVITY_M_S2 = 9.81
RANK_TOLERANCE = 1e-12
"""Of the largest singular value; what is less is rounding."""
NEGLIGIBLE = 1e-6
"""Length of a differential, before it is scaled, that rounding leaves where terms cancel; others are about 1."""

_PHI1_DEG, _PHI2_DEG, _PHI12_DEG = (10.0, 80.0), (50.0, 130.0), 172.0
_RADIUS_M, _RADIUS_SD_M, _OFFSET_SD_M = (0.016, 0.024), 1e-3, 1.5e-3
_GYRATION = (0.6, 0.8)
_PALM_RATE_RAD_S, _SPIN_RAD_S = 2.0, 4.0


@dataclass(frozen=True, slots=True)
class RankVerdict:
    """One case at many states: the codistribution's size, its usual rank, and how well it is conditioned."""

    case: Case
    functions: int
    states: int
    rank: int
    full: float  # share of the states at which the rank is that of the state
    smallest: float  # median of the smallest singular value
    condition: float  # median of largest over smallest; infinite when the rank is short

    @property
    def observable(self) -> bool:
        """Whether the usual rank is full."""
        return self.rank == self.states


def _unit(name: str) -> float:
    """Of one quantity of `POINT` in ℓ and √(ℓ/g), SI; the mass scales differentials alone."""
    if name.startswith("omega"):
        return math.sqrt(GRAVITY_M_S2 / LENGTH_M)
    return {"phi1": 1.0, "phi2": 1.0, "mass": 1.0, "gravity": GRAVITY_M_S2}.get(name, LENGTH_M)


_UNITS: FloatArray = np.array([_unit(name) for name in POINT])


def scaled(points: FloatArray) -> FloatArray:
    """The same `points` (n, 12), SI, counted in ℓ and √(ℓ/g)."""
    values: FloatArray = points / _UNITS
    return values


def singular_values(case: Case, points: FloatArray) -> FloatArray:
    """Of the scaled codistribution at each of `points` (n, 12), SI, the largest first: (n, states), no unit.

    NaN where the paper's equations divide by zero.
    """
    rows = codistribution(case, scaled(points))
    values = np.full((len(rows), min(rows.shape[1:])), np.nan)
    defined = np.isfinite(rows).all(axis=(1, 2))
    length = np.linalg.norm(rows[defined], axis=2, keepdims=True)
    alike = rows[defined] / np.where(length < NEGLIGIBLE, np.inf, length)
    values[defined] = np.linalg.svd(alike, compute_uv=False)
    return values


def random_states(count: int, seed: int) -> FloatArray:
    """(n, 12) states as `POINT` orders them, SI: objects of 16 to 24 mm touched by both palms, all in motion."""
    random = np.random.default_rng(seed)
    phi1, phi2 = (np.deg2rad(random.uniform(*limits, count)) for limits in (_PHI1_DEG, _PHI2_DEG))
    phi2 = np.minimum(phi2, np.deg2rad(_PHI12_DEG) - phi1)
    radius = random.uniform(*_RADIUS_M, count)
    r1, r2 = radius + random.normal(0.0, _RADIUS_SD_M, (2, count))
    d1, d2 = random.normal(0.0, _OFFSET_SD_M, (2, count))
    s1 = (r1 * np.cos(phi2) + r2) / np.sin(phi2) - d1  # (3.13)
    s2 = (r2 * np.cos(phi2) + r1) / np.sin(phi2) + d2  # (3.14)
    omega1, omega2 = random.uniform(-_PALM_RATE_RAD_S, _PALM_RATE_RAD_S, (2, count))
    omega0 = random.uniform(-_SPIN_RAD_S, _SPIN_RAD_S, count)
    rho = radius * random.uniform(*_GYRATION, count)
    rest = np.broadcast_to([[0.1], [GRAVITY_M_S2]], (2, count))
    return np.stack([r1, r2, omega0, s1, s2, phi1, omega1, phi2, omega2, rho, *rest], axis=1)


def judged(points: FloatArray) -> list[RankVerdict]:
    """Each case at all of `points` (n, 12), SI, n ≥ 1."""
    return [_judged(case, points) for case in CASES]


def _judged(case: Case, points: FloatArray) -> RankVerdict:
    _, functions, states = codistribution(case, points[:1]).shape
    values = singular_values(case, points)
    ranks = (values > RANK_TOLERANCE * values[:, :1]).sum(axis=1)
    rank = int(np.median(ranks))
    smallest = float(np.median(values[:, -1])) if rank == states else 0.0
    condition = float(np.median(values[:, 0] / values[:, -1])) if rank == states else np.inf
    return RankVerdict(case, functions, states, rank, float(np.mean(ranks == states)), smallest, condition)
