"""How far what is off leads an outline astray, and how well its readings could tell what it is: the best there is.

By linearisation at the truth. With the constants of the rig open, but for the vibration's, which are as believed, the
readings leave a covariance; let M be what they tell of these constants alone, B what is believed of them and ∂h/∂κ what
of the outline goes with them. An estimate that goes by B, where the rig is off by d, is led astray by
∂h/∂κ ((M + B⁻¹)⁻¹ M − 1) d, and no test aimed at d sees more than √(dᵀ K d) of its own sigmas, K = (M⁻¹ + B)⁻¹
(Cramér and Rao; Neyman and Pearson).
"""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import Event, FloatArray
from palmd.model import shape
from palmd.model.smoothing import CONSTANTS, RIG, RIG_CONSTANTS, C
from palmd.observer.bound import Truth, at_truth
from palmd.observer.criticism import CAUSES, FREE_SD, LEFT, RigBelief
from palmd.observer.factor import given
from palmd.system.description import RigDescription
from palmd.system.rig_constants import RIG_NAMES

SEEN = 4.8  # sigmas: what is looked for in forty ways (twenty causes, two signs) with one false alarm in a hundred
# runs needs 3.5, and 1.3 more to be seen nine times in ten
APART = 3.3  # sigmas from the likeliest other cause: taken for that one time in twenty


@dataclass(frozen=True, slots=True)
class Telling:
    """bias: of the outline where touched, in one-sigmas of the same run with nothing off (RMS over RMS).

    sigmas: of the best test there can be. apart: of them, those that no other single cause has as well.
    """

    bias: float
    sigmas: float
    apart: float

    @property
    def told(self) -> bool:
        """Whether readings tell well enough what is off for it to be named nine times in ten."""
        return self.sigmas >= SEEN and self.apart >= APART


def telling(
    events: Sequence[Event], rig: RigDescription, truth: Truth, rig_off: FloatArray, named: Container[str]
) -> Telling:
    """Of a rig whose constants are off by `rig_off`, those beyond what is believed being `named` by right.

    Raises ValueError where there is nothing to reconstruct, LinAlgError where readings leave the object open.
    """
    believed = RigBelief.of(rig).sd
    open_sd = np.where(LEFT > 0.0, 10 * FREE_SD, believed)
    wide = RigBelief(open_sd, np.zeros(RIG_CONSTANTS), open_sd)
    at = at_truth(events, rig, truth, wide, rig_off)
    d = np.where([name in named for name in RIG_NAMES], rig_off, 0.0)
    covariance = at.covariance[:CONSTANTS, :CONSTANTS]
    told = _inverse(covariance[RIG, RIG]) - np.diag(wide.sd**-2.0)
    left = _inverse(told + np.diag(believed**-2.0))
    by_rig = np.linalg.solve(
        covariance[RIG, RIG] / np.outer(open_sd, open_sd), covariance[RIG, C.SHAPE :] / open_sd[:, None]
    )
    turned = shape.gauge_free_basis(at.touched, at.touched, at.guess.p[C.SHAPE :])
    by_rig = turned @ (by_rig.T / open_sd)
    rest = given(covariance, RIG, slice(C.SHAPE, CONSTANTS))
    variance = ((turned @ rest) * turned).sum(axis=1) + ((by_rig @ left) * by_rig).sum(axis=1)
    astray = by_rig @ (left @ (told @ d) - d)
    information = told - told @ left @ told
    pull = information @ d
    others = [c for c in CAUSES if any(moved and name not in named for moved, name in zip(c, RIG_NAMES, strict=True))]
    as_well = max(
        (float(c @ pull) ** 2 / float(c @ information @ c) for c in others if c @ information @ c > 0.0), default=0.0
    )
    seen = float(d @ pull)
    return Telling(
        math.sqrt(float(np.mean(astray**2) / np.mean(variance))),
        math.sqrt(max(seen, 0.0)),
        math.sqrt(max(seen - as_well, 0.0)),
    )


def _inverse(matrix: FloatArray) -> FloatArray:
    scale = 1.0 / np.sqrt(np.diagonal(matrix))
    inverse: FloatArray = np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale)
    return inverse
