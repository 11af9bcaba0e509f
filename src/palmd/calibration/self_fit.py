"""Combines the information of several runs, with different objects, about the one rig's constants. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.system.rig_constants import determined


@dataclass(frozen=True, slots=True)
class RigFit:
    """Errors of the constants in `system.rig_constants.RIG_TABLE`, their covariance, and their priors' 1σ."""

    values: FloatArray
    covariance: FloatArray
    priors: FloatArray

    @property
    def sds(self) -> FloatArray:
        """1σ of each constant."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def determined(self) -> npt.NDArray[np.bool_]:
        """Which constants the runs determine."""
        return determined(self.sds, self.priors)

    @property
    def independent_sds(self) -> FloatArray:
        """1σ values whose diagonal covariance bounds the joint covariance; limited to those of the priors."""
        correlation = self.covariance / np.outer(self.sds, self.sds)
        widening = math.sqrt(np.linalg.eigvalsh(correlation)[-1])
        return np.minimum(widening * self.sds, self.priors)


def combined(runs: Iterable[tuple[FloatArray, FloatArray, FloatArray]], priors: FloatArray) -> RigFit:
    """Combine the runs: add each posterior's (mean, covariance) information beyond its prior's, and `priors` once.

    Priors have mean zero and nonzero 1σ; the third item of a run is the prior with which it was reconstructed.
    """
    units, own = np.outer(priors, priors), np.eye(len(priors))
    information: FloatArray = own.copy()
    side = np.zeros(len(priors))
    for mean, covariance, prior in runs:
        of_run = np.linalg.inv(covariance / units)
        information += of_run - np.diag((priors / prior) ** 2)
        side += of_run @ (mean / priors)
    together = np.linalg.inv(information)
    return RigFit(priors * (together @ side), together * units, priors)
