"""What runs with several objects tell of the one rig: their information about its constants, added up. Pure."""

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
    """What each constant of `system.rig_constants.RIG_TABLE` is off by, their covariance, their priors' one-sigmas."""

    values: FloatArray
    covariance: FloatArray
    priors: FloatArray

    @property
    def sds(self) -> FloatArray:
        """One-sigma of each."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def told(self) -> npt.NDArray[np.bool_]:
        """Which of them the runs have told."""
        return determined(self.sds, self.priors)

    @property
    def independent_sds(self) -> FloatArray:
        """One-sigmas that, taken for independent, claim no more than the covariance; never more than the priors."""
        correlation = self.covariance / np.outer(self.sds, self.sds)
        widening = math.sqrt(np.linalg.eigvalsh(correlation)[-1])
        return np.minimum(widening * self.sds, self.priors)


def combined(runs: Iterable[tuple[FloatArray, FloatArray, FloatArray]], priors: FloatArray) -> RigFit:
    """All runs together: the sum of what each posterior (mean, covariance) tells beyond its prior, and `priors` once.

    Priors have mean zero, and one-sigmas that are not zero; the last of three is that which the run was found with.
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
