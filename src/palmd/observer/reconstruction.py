"""What a whole record tells, as every way of reconstructing gives it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.record import lasting
from palmd.observer.shape_classification import UNTOLD, ShapeClass
from palmd.observer.visits import Counts

PAUSE_S = 0.05  # between nodes, from which on nothing is told of the motion there


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """What a record tells; SI units, NaN or None where there is no value.

    theta, h, h_sd, touched, visits: 360 normals (rad), support function and its one-sigma (m), whether a palm touched
    there, and how many separate times.
    rig, rig_covariance: the rig's constants, as in `model.smoothing.R`, and their covariance; none where empty.
    contradicted: by how many sigmas each of them is not what it was taken for, 0 where nothing speaks against that.
    rig_prior_sd: the one-sigmas that they are taken for beforehand, opened where that is contradicted. rig_by_prior:
    values and covariance by these alone, where doubt about them is in `rig_covariance` besides.
    t, psi, omega0, radii (one row a palm): the trajectory at the nodes. `chi2` is per contact reading. `reason` says
    why not, when not `converged`. turned_sd: one-sigma of psi[-1] − psi[0] (rad), where the record is of one segment.
    sides: flat sides of the outline that were felt, one a row: outward normal (rad), length and its one-sigma (m).
    likeness: which simple form the outline is of, if any. evidence: log marginal likelihood of the readings under this
    description of the rig, up to a constant of them; NaN where nobody has worked it out.
    """

    converged: bool
    chi2: float
    theta: FloatArray
    h: FloatArray | None
    h_sd: FloatArray | None
    touched: npt.NDArray[np.bool_] | None
    visits: Counts | None
    rho: float
    rho_sd: float
    mu: float
    mu_sd: float
    mass: float
    mass_sd: float
    rig: FloatArray
    rig_covariance: FloatArray
    contradicted: FloatArray
    rig_prior_sd: FloatArray
    t: FloatArray
    psi: FloatArray
    omega0: FloatArray
    radii: FloatArray
    reason: str
    seconds: float
    turned_sd: float = math.nan
    sides: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    shape_class: ShapeClass = UNTOLD
    rig_by_prior: tuple[FloatArray, FloatArray] | None = None
    evidence: float = math.nan

    @property
    def spans(self) -> list[tuple[float, float]]:
        """From when to when (s) the motion is told without a pause."""
        pauses = np.flatnonzero(np.diff(self.t) > PAUSE_S)
        return list(zip(self.t[[0, *pauses + 1]].tolist(), self.t[[*pauses, -1]].tolist(), strict=True))

    @property
    def lasts(self) -> float:
        """For how long it is told (s), without the pauses."""
        return lasting(self.spans)

    @property
    def rig_sd(self) -> FloatArray:
        """One-sigma of the rig's constants."""
        return np.sqrt(np.diagonal(self.rig_covariance))
