"""Where the smoother may start: what a bank of filters, started blind, makes of a record's first seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import Event, FloatArray, PadSample, RigDescription
from palmd.model import shape
from palmd.model.shape_map import Z
from palmd.model.smoothing import CONSTANTS, ORDER, C
from palmd.observer import prior
from palmd.observer.filters import ShapeFilters
from palmd.observer.live import BankObserver
from palmd.observer.smoother import Guess, Prior

BANK = 64
SPACING_S = 0.01  # of the remembered trajectories
MASS_KG, LN_MASS_SD = 0.15, 1.5
# Wider than the live observer's belief: a ring (ratio 1) and a body with a heavy core must stay possible.
LN_GYRATION_SD = 0.12


@dataclass(frozen=True, slots=True)
class Start:
    """One filter of the bank at the end of its time: how likely, its trajectory (n, 2) at `t`, and its constants."""

    score: float
    t: FloatArray
    trajectory: FloatArray
    constants: FloatArray

    def guess(self, t: FloatArray) -> Guess:
        """The same on other nodes, held constant outside its own time."""
        columns = [np.interp(t, self.t, self.trajectory[:, i]) for i in range(2)]
        return Guess(np.stack(columns, axis=1), self.constants)


def blind_starts(
    events: Sequence[Event], rig: RigDescription, seconds: float, seed: int, size: int = BANK
) -> list[Start]:
    """Every filter of a bank that has read the first `seconds` of `events`, the likeliest first; maybe none."""
    filters = ShapeFilters(rig, size)
    observer = BankObserver(filters, rig, seed)
    end = events[0].t_sample + seconds
    times: list[float] = []
    states: list[FloatArray] = []
    for event in events:
        if event.t_sample > end:
            break
        observer.feed(event)
        if observer.begun < math.inf and (not times or event.t_sample >= times[-1] + SPACING_S):
            times.append(event.t_sample)
            states.append(filters.bank.x.copy())
    if not times or not observer.begun < math.inf:
        return []
    at, score = np.array(times), filters.bank.score
    order = [int(i) for i in np.argsort(-score, kind="stable")]
    same = [state for state in states if len(state) == len(states[-1])]  # filters keep their places until one goes
    trajectories = np.array([state[:, [Z.PSI, Z.OMEGA0]] for state in same])
    at = at[-len(same) :]
    return [Start(float(score[i]), at, trajectories[:, i], _constants(states[-1][i])) for i in order]


def prior_of(pads: Sequence[PadSample], tangents: FloatArray) -> Prior:
    """The blind belief about the smoother's constants.

    `tangents` holds tan(φ2/2) at each reading: for a circle both readings are its radius over that (3.13), so the
    mean of s·tan(φ2/2) over the first readings tells about how large the object is.
    """
    radius = float(np.mean([sample.s * tangent for sample, tangent in zip(pads, tangents, strict=True)]))
    mean, sd = np.zeros(CONSTANTS), np.zeros(CONSTANTS)
    mean[C.LN_RHO], sd[C.LN_RHO] = math.log(prior.GYRATION), LN_GYRATION_SD
    mean[C.MU], sd[C.MU] = prior.FRICTION, prior.FRICTION_SD
    mean[C.LN_DITHER], sd[C.LN_DITHER] = math.log(prior.DITHER), prior.LN_DITHER_SD
    mean[C.DAMPING], sd[C.DAMPING] = prior.DAMPING, prior.DAMPING_SD
    mean[C.LN_MASS], sd[C.LN_MASS] = math.log(MASS_KG), LN_MASS_SD
    sd[C.SHAPE :] = shape.prior_sd(radius, ORDER)
    mean[C.SHAPE], sd[C.SHAPE] = radius, prior.RADIUS_SD * radius
    return Prior(mean, sd, prior.SPIN_MOVING_SD)


def _constants(x: FloatArray) -> FloatArray:
    p = np.zeros(CONSTANTS)
    p[[C.LN_RHO, C.MU, C.LN_DITHER, C.DAMPING]] = x[[Z.LN_RHO, Z.MU, Z.LN_DITHER, Z.DAMPING]]
    p[C.LN_MASS] = math.log(MASS_KG)
    p[C.SHAPE : C.SHAPE + shape.COEFFICIENTS] = x[Z.SHAPE :]
    return p
