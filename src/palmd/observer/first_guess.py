"""First guesses for the smoother: the likeliest of a bank of filters, started blind on a record's first seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import Event, FloatArray
from palmd.model import shape
from palmd.model.shape_map import Z
from palmd.model.smoothing import CONSTANTS, ORDER, RIG, C, R
from palmd.observer import prior
from palmd.observer.bank_observer import BankObserver
from palmd.observer.factor import Prior
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.normal_equations import Guess
from palmd.system.description import RigDescription
from palmd.system.vibration import Vibration

BANK = 64
SPACING_S = 0.01  # of the stored trajectories
MASS_KG, LN_MASS_SD = 0.15, 1.5
# Wider than the live observer's prior: a ring (ratio 1) and a body with a heavy core must stay possible.
LN_GYRATION_SD = 0.12


@dataclass(frozen=True, slots=True)
class FirstGuess:
    """One filter at the end of the bank's time: its trajectory (n, 2) at `t`, and its constants."""

    t: FloatArray
    trajectory: FloatArray
    constants: FloatArray

    def guess(self, t: FloatArray) -> Guess:
        """The guess on other nodes; outside its own time the trajectory is constant."""
        columns = [np.interp(t, self.t, self.trajectory[:, i]) for i in range(2)]
        return Guess(np.stack(columns, axis=1), self.constants)


def blind_starts(
    events: Sequence[Event],
    rig: RigDescription,
    begin: float,
    seconds: float,
    seed: int,
    count: int = BANK,
    asymmetry: float = 0.0,
) -> list[FirstGuess]:
    """The `count` likeliest filters, best first, of a bank that has read `events` until `seconds` after `begin` (s).

    asymmetry: assumed asymmetry of the palms' friction, (μ1 − μ2)/(μ1 + μ2). Empty where no object was found.
    """
    filters = ShapeFilters(rig, BANK)
    filters.rig_error.values[R.FRICTION] = asymmetry
    observer = BankObserver(filters, rig, seed)
    end = begin + seconds
    times: list[float] = []
    states: list[FloatArray] = []
    for event in events:
        if event.t_sample > end:
            break
        observer.feed(event)
        if observer.start_time < math.inf and (not times or event.t_sample >= times[-1] + SPACING_S):
            times.append(event.t_sample)
            states.append(filters.bank.x.copy())
    if not times or not observer.start_time < math.inf:
        return []
    at = np.array(times)
    order = [int(i) for i in np.argsort(-filters.bank.score, kind="stable")[:count]]
    # filters keep their numbers until one is dropped
    same = [state for state in states if len(state) == len(states[-1])]
    trajectories = np.array([state[:, [Z.PSI, Z.OMEGA0]] for state in same])
    at = at[-len(same) :]
    return [FirstGuess(at, trajectories[:, i], constants_of(states[-1][i], asymmetry)) for i in order]


def prior_of(radius: float, rig_sd: FloatArray, vibration: Vibration) -> Prior:
    """Blind prior of the smoother's constants.

    radius: of the circle of the first readings (m): about how large the object is. rig_sd: 1σ of the rig's constants.
    """
    mean, sd = np.zeros(CONSTANTS), np.zeros(CONSTANTS)
    mean[C.LN_RHO], sd[C.LN_RHO] = math.log(prior.GYRATION), LN_GYRATION_SD
    mean[C.DRAG], sd[C.DRAG] = prior.FRICTION, prior.FRICTION_SD
    mean[C.SATURATION], sd[C.SATURATION] = prior.ln_dither_of(vibration)
    mean[C.DAMPING], sd[C.DAMPING] = prior.DAMPING, prior.DAMPING_SD
    mean[C.LN_MASS], sd[C.LN_MASS] = math.log(MASS_KG), LN_MASS_SD
    sd[C.SHAPE :] = shape.prior_sd(radius, ORDER)
    mean[C.SHAPE], sd[C.SHAPE] = radius, prior.RADIUS_SD * radius
    sd[RIG] = rig_sd
    return Prior(mean, sd, prior.SPIN_MOVING_SD)


def constants_of(x: FloatArray, asymmetry: float = 0.0) -> FloatArray:
    """The smoother's constants of a state of `model.shape_map`, of any order; the mass is a default."""
    p = np.zeros(CONSTANTS)
    p[[C.LN_RHO, C.DAMPING]] = x[[Z.LN_RHO, Z.DAMPING]]
    dither = math.exp(x[Z.LN_DITHER])
    p[C.DRAG], p[C.SATURATION] = x[Z.MU] / dither, dither**-2.0
    p[C.LN_MASS] = math.log(MASS_KG)
    p[C.RIG + R.FRICTION] = asymmetry
    outline = x[Z.SHAPE :]
    p[C.SHAPE : C.SHAPE + len(outline)] = outline
    return p
