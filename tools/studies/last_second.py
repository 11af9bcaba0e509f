"""How much a second at constant palm rates tells about a typical object: palmd's figure, noise and friction counted.

The object lies at rest when the palms begin to turn, and moves as the shape map says. Half a second later the palms
pass the same pose, whatever their rate. The pads read at 100 Hz.
"""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray, PalmMotion
from palmd.model import shape, shape_map
from palmd.model.outputs import NAMED, rig_inputs
from palmd.observer import prior
from palmd.observer.observability import SAMPLE_S, WINDOW_S, Observability
from palmd.rig.plant import stable_poses
from palmd.rig.shapes import random_body
from palmd.system.description import RigDescription

PHI1_RAD, PHI2_RAD = math.radians(40.0), math.radians(95.0)
"""The palms' pose in mid-second."""
PAD_RATE_HZ = 100.0
_NORMALS = 360


def told(omega1: float, omega2: float, seed: int = 1) -> float:
    """Prior over error of what that second tells worst of r1, r2, s1, s2, at palm rates in rad/s; no unit.

    NaN when the object leaves a palm on the way. Takes some 20 ms; may compile C.
    """
    rig = RigDescription(hinge="fixed")
    angles = (PHI1_RAD - omega1 * WINDOW_S / 2, PHI2_RAD - omega2 * WINDOW_S / 2)
    begin = PalmMotion(angles, (omega1, omega2), (0.0, 0.0))
    x = _object_at(begin, seed)
    predict, named = shape_map.predict_function(), shape_map.named_function()
    follower = Observability(rig_inputs(rig), rig.reading_variances)
    forces = [NAMED.index("f1"), NAMED.index("f2")]
    palms = np.array([*begin.angles, *begin.rates, *begin.accelerations])
    for step in range(round(WINDOW_S / SAMPLE_S) + 1):
        t = step * SAMPLE_S
        values = np.asarray(named(x, [*palms, *rig_inputs(rig)])[0]).ravel()
        if values[forces].min() <= 0.0:
            return math.nan
        if step == 0:
            s1, s2 = values[NAMED.index("s1")], values[NAMED.index("s2")]
            start = prior.blind_start((s1, s2), begin, 1, True, np.random.default_rng(0))
            follower.begin(t, prior.shape_map_sd(start))
        follower.sample(t, x, palms, np.zeros(2))
        for _ in range(round((t + SAMPLE_S) * PAD_RATE_HZ) - round(t * PAD_RATE_HZ)):
            follower.count(1)
            follower.count(2)
        u = [SAMPLE_S, *palms, 0.0, 0.0, *rig_inputs(rig)]
        x = np.asarray(predict(x, np.zeros((shape_map.N, shape_map.N)), u)[0]).ravel()
        palms[:2] += SAMPLE_S * palms[2:4]
    return follower.value()


def _object_at(palms: PalmMotion, seed: int) -> FloatArray:
    """The state of `model.shape_map` of an ordinary object at rest in a stable pose, turned so that ψ = 0."""
    body = random_body("nominal", np.random.default_rng(seed))
    body = body.turned(stable_poses(body, palms)[0])
    Z = shape_map.Z  # noqa: N806
    x = np.zeros(shape_map.N)
    x[Z.SHAPE :] = shape.coefficients_of(body.support.sample(np.arange(_NORMALS) * math.tau / _NORMALS))
    x[[Z.LN_RHO, Z.LN_DITHER]] = np.log([body.rho, prior.DITHER])
    x[[Z.MU, Z.DAMPING]] = prior.FRICTION, prior.DAMPING
    return x
