"""Shape-map filters that fuse readings in NumPy: the oracle of `model/fusion.c`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palmd.events import Event, FloatArray, PadSample, PalmSample
from palmd.model import shape_map
from palmd.model.outputs import NAMED, RIG_INPUTS
from palmd.model.smoothing import R
from palmd.model.touch import LEAST_CURVATURE_MARGIN
from palmd.observer.bank import Bank
from palmd.observer.filters.base import LONGEST_STEP_S, pad_update
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.palms import PalmTracker
from palmd.observer.rig_error import RigError
from palmd.system.description import RigDescription
from palmd.system.mechanism import CONTACTS, JOINT_RATES, JOINTS, OPENING, PALMS

_ANGLES, _CONTACTS, _JOINTS = (
    [NAMED.index(name) for name in names] for names in (JOINTS, CONTACTS, (*JOINTS, *JOINT_RATES))
)


class PlainShapeFilters(ShapeFilters):
    """Same filters; `bank` calls the kernels one by one."""

    def __init__(self, rig: RigDescription, size: int, order: int = shape_map.HARMONICS):
        super().__init__(rig, size, order=order)
        library, n = shape_map.library(order, rig.curved), shape_map.size(order)
        self._curvatures = rig.curvatures if rig.curved else ()
        updates = dict.fromkeys(shape_map.UPDATES, shape_map.UPDATE_INPUTS + len(self._curvatures))
        inputs = (shape_map.PREDICTION_INPUTS, shape_map.PALM_INPUTS + RIG_INPUTS, len(NAMED))
        self.bank = Bank(library, size, n, updates, inputs)
        self._x, self._P, self._x_next, self._P_next = np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros((n, n))
        self._u, self._v = np.zeros(shape_map.PREDICTION_INPUTS), np.zeros(shape_map.PALM_INPUTS + RIG_INPUTS)
        self._y, self._J = np.zeros(len(NAMED)), np.zeros((n + len(PALMS), len(NAMED)))
        self._predict = library.bind("predict", [self._x, self._P, self._u], [self._x_next, self._P_next])
        self._named = library.bind("named", [self._x_next, self._v], [self._y, self._J])

    def tracker(self, angle_noise: float) -> PalmTracker:
        return PalmTracker(angle_noise)

    def propagate(self, t: float, until: float, palms: PalmTracker, repeated: float) -> None:
        gap = until - t
        steps = max(1, math.ceil(gap / LONGEST_STEP_S))
        for _ in range(steps):
            self.bank.predict(gap / steps, self._palms_at(t, palms), palms.jerk, self._rig_now())
            t += gap / steps
        self.bank.age_scores(gap / repeated)

    def fuse_pad(self, sample: PadSample, variance: float, palms: PalmTracker, repeated: float) -> None:
        angles = self._palms_at(sample.t_sample, palms)[: len(JOINTS)]
        s = corrected(self.rig_error, sample, angles[OPENING], float(self.bank.x[0, shape_map.Z.SHAPE]))
        self.bank.update(pad_update(sample.pad), s, variance, *angles, *self._curvatures, repeated=repeated)

    def fuse_events(
        self, events: Sequence[Event], t: float, palms: PalmTracker, variances: FloatArray, shared: FloatArray
    ) -> tuple[float, int]:
        read = 0
        for event in events:
            if isinstance(event, PalmSample):
                palms.feed(event)
            elif isinstance(event, PadSample) and (sample := self.rig_error.on_time(event)).t_sample >= t:
                self.propagate(t, sample.t_sample, palms, math.inf)
                t = sample.t_sample
                repeated = max(palms.repeated, float(shared[sample.pad - 1]))
                self.fuse_pad(sample, float(variances[sample.pad - 1]), palms, repeated)
                read += 1
        return t, read

    def named(self, member: int, t: float, dt: float, palms: PalmTracker) -> tuple[list[float], list[float]]:
        self._x[:], self._P[:] = self.bank.x[member], self.bank.P[member]
        self._u[0], self._u[1:7], self._u[7:9] = dt, self._palms_at(t, palms), palms.jerk
        self._u[9:] = self._v[shape_map.PALM_INPUTS :] = self._rig_now()
        self._predict()
        self._v[: shape_map.PALM_INPUTS] = self._palms_at(t + dt, palms)
        self._named()
        n, error, y, spread = self.bank.n, self.rig_error, self._y, self._present_spread()
        J, by_angles = self._J[:n], self._J[n:]
        variance = ((self._P_next @ J) * J).sum(axis=0)
        variance[_JOINTS] += np.ravel(palms.sd(t + dt)) ** 2
        variance += self._added_variances[int(spread is not None)]
        radius = self._x_next[shape_map.Z.SHAPE]
        by_height = np.array([lifts(error, k, y[_ANGLES[1]], radius) for k in range(len(PALMS))])
        y[_CONTACTS] += by_height @ heights(error, error.values)
        y[_ANGLES] -= bows(error, error.values)  # angles of the palms, not of their bowed surfaces at the contacts
        if spread is not None:
            steps = J.T @ spread[:n]
            if len(rig_steps := spread[n:]):
                bowed = bows(error, rig_steps)
                steps += by_angles.T @ (rig_steps[[R.TILT, R.TURN]] + bowed)
                steps[_ANGLES] -= bowed
                steps[_CONTACTS] += by_height @ heights(error, rig_steps)
            variance += (steps**2).sum(axis=1)
        return y.tolist(), variance.tolist()


def _u(error: RigError, pad: int) -> float:
    return float(error.s[pad]) / error.pad_lengths[pad]


def bows(error: RigError, values: FloatArray) -> FloatArray:
    """Increase of φ1 and φ2 due to bowed surfaces at the last contacts (rad), for constants (RIG, …)."""
    one, two = (
        4.0 * values[R.SAGITTA + i] / length * (1.0 - 2.0 * _u(error, i)) for i, length in enumerate(error.pad_lengths)
    )
    return np.array([one, -one - two])


def heights(error: RigError, values: FloatArray) -> FloatArray:
    """Height of both surfaces above the hinge line at the last contacts (m), for constants (RIG, …)."""
    return np.array([values[R.STANDOFF + k] + 4.0 * values[R.SAGITTA + k] * _u(error, k) ** 2 for k in range(2)])


def lifts(error: RigError, palm: int, opening: float, radius: float) -> FloatArray:
    """Shift of a contact on `palm` (0, 1) away from the hinge per metre of each surface's height.

    On a curved palm the shift is 1/(1 − κ·radius) times that on a flat one.
    """
    margin = 1.0
    if any(error.curvatures):
        opening -= sum(each * at for each, at in zip(error.curvatures, error.s, strict=True))
        margin = max(1.0 - error.curvatures[palm] * radius, LEAST_CURVATURE_MARGIN)
    shift = np.full(len(PALMS), 1.0 / math.sin(opening) / margin)
    shift[palm] = math.cos(opening) / math.sin(opening) / margin
    return shift


def corrected(error: RigError, sample: PadSample, opening: float, radius: float) -> float:
    """The reading (m) of an ideal pad on the hinge line."""
    i, v = sample.pad - 1, error.values
    compliance = v[R.FORCE + i] * error.pressing(sample)
    error.s[i] = s = float((sample.s - v[R.ZERO + i] - compliance) / (1.0 + v[R.SCALE + i]))
    return float(s - lifts(error, i, opening, radius) @ heights(error, v))
