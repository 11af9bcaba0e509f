"""A known body on three palms without a daemon: its least-squares parameters, and the result of a move."""

from __future__ import annotations

import math

import numpy as np

from palmd.config.three_palms import ThreePalmsLimitsConfig
from palmd.events import FloatArray
from palmd.model.icosphere import icosphere
from palmd.model.spherical import Y00, evaluator
from palmd.model.three_palms import MOMENT
from palmd.motion.segments import Move
from palmd.observer.three_palms.body import ORDER
from palmd.rig.three_palms.bodies import Bodies, random_bodies
from palmd.rig.three_palms.plant import BodyOnPalms, FrictionParameters, palm_rows
from palmd.system.three_palms import palms_at, readings_of, room_on_pads
from tools.studies.space_logs import KINDS, STEP_S, initial_states

WIDE = ThreePalmsLimitsConfig(beta_deg=(10.0, 80.0), gamma2_deg=(15.0, 75.0), gamma3_deg=(15.0, 75.0))
MU, DITHER_M_S = (0.05, 0.2), (8e-3, 1.2e-2)


def known_parameters(body: Bodies, rubbing: FrictionParameters) -> FloatArray:
    """Parameters of `model.three_palms` of the first of these bodies, by least squares over the sphere."""
    directions = icosphere()[0]
    h = body.support(directions[None])[0][0]
    c = np.linalg.lstsq(evaluator(ORDER)(directions)[0], h, rcond=None)[0]
    moment = 0.5 * np.trace(body.inertia[0]) * np.eye(3) - body.inertia[0]
    root = np.linalg.cholesky(moment) / (MOMENT * Y00 * c[0])
    lam = [math.log(root[i, j]) if i == j else root[i, j] for i in range(3) for j in range(i + 1)]
    resisting = [float(rubbing.drag[0]), float(rubbing.mu[0]), math.log(float(rubbing.dither[0]))]
    return np.concatenate([c, lam, resisting])


class BodyStand:
    """One body on the palms."""

    def __init__(self, seed: int, gravity: float) -> None:
        random = np.random.default_rng(seed)
        body = random_bodies(1, random)
        rubbing = FrictionParameters(random.uniform(*MU, 1), random.uniform(*DITHER_M_S, 1), np.zeros(1))
        self.plant = BodyOnPalms(body, rubbing, gravity)
        self.plant.state[:] = initial_states(body, rubbing, KINDS["friction"], random, gravity)[0]

    @property
    def bearings(self) -> tuple[FloatArray, FloatArray]:
        """Rotation (1, 3, 3) and spin (1, 3)."""
        return self.plant.state[6:15].reshape(1, 3, 3).copy(), self.plant.state[None, 15:].copy()

    def moved(self, move: Move, side: float) -> tuple[FloatArray, bool]:
        """(T, 3 palms, 3) normals touched during a move; whether all palms kept their contacts."""
        steps = round(move.duration / STEP_S)
        motion = [move.at(0.5 * k * STEP_S) for k in range(2 * steps + 1)]
        each = ([getattr(one, name) for one in motion] for name in ("angles", "rates", "accelerations"))
        planes = palms_at(*map(np.array, each))
        rows, normals, points = palm_rows(planes), np.empty((steps, 3, 3)), np.empty((2 * steps + 1, 3, 3))
        for k in range(steps):
            self.plant.advance(rows[2 * k : 2 * k + 3], STEP_S)
            points[2 * k + 2] = self.plant.point
            normals[k] = -planes.normal[2 * k + 2] @ self.plant.state[6:15].reshape(3, 3)
            if not (self.plant.force > 0.0).all():
                return normals[:k], False
        read = readings_of(planes, points)[2::2]
        return normals, bool((room_on_pads(read, side) > 0.0).all())
