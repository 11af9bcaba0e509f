"""Result of reconstructing a whole record, the same for every method."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.record import total_duration
from palmd.observer.shape_classification import UNCLASSIFIED, ShapeClass
from palmd.observer.visits import Counts
from palmd.system.reasons import NO_REASON, Reason

PAUSE_S = 0.05  # between nodes, from which on the motion in between is unknown


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """Estimates from a record; SI units, NaN or None where there is no value.

    theta, h, h_sd, touched, visits: 360 normals (rad), support function and its 1σ (m), whether a palm touched there,
    and on how many separate occasions.
    rig, rig_covariance: the rig's constants, as in `model.smoothing.R`, and their covariance; empty where there is
    none.
    contradicted: by how many σ each of them deviates from the description, 0 where nothing contradicts that.
    rig_prior_sd: their prior 1σ, opened where contradicted. rig_by_prior: values and covariance with this prior only,
    where `rig_covariance` also includes considered deviations.
    t, psi, omega0, radii (one row a palm): the trajectory at the nodes. chi2: per contact reading. reason: why it is
    not `converged`. turned_sd: 1σ of psi[-1] − psi[0] (rad), where the record is of one segment.
    sides: flat sides of the outline that were touched, one a row: outward normal (rad), length and its 1σ (m).
    shape_class: which simple shape the outline is, if any.
    evidence: log marginal likelihood of the readings under this description of the rig, up to a constant; NaN where not
    computed.
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
    seconds: float
    reason: Reason = NO_REASON
    turned_sd: float = math.nan
    sides: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    shape_class: ShapeClass = UNCLASSIFIED
    rig_by_prior: tuple[FloatArray, FloatArray] | None = None
    evidence: float = math.nan

    @property
    def spans(self) -> list[tuple[float, float]]:
        """Time spans (s) in which the motion is known without a pause."""
        pauses = np.flatnonzero(np.diff(self.t) > PAUSE_S)
        return list(zip(self.t[[0, *pauses + 1]].tolist(), self.t[[*pauses, -1]].tolist(), strict=True))

    @property
    def lasts(self) -> float:
        """Total duration (s) of the spans."""
        return total_duration(self.spans)

    @property
    def rig_sd(self) -> FloatArray:
        """1σ of the rig's constants."""
        return np.sqrt(np.diagonal(self.rig_covariance))
