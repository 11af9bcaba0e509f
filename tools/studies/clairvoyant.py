"""An observer that is told the truth: with it the explorer shows how soon it could be done, knew it the object."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from palmd.events import FloatArray, Outlook
from palmd.model import shape_map
from palmd.model.shape import coefficients_of
from palmd.motion.rollout_predictor import BINS, Bools
from palmd.rig.world import World
from tools.studies.silent_observer import SilentObserver

Z = shape_map.Z


class Clairvoyant(SilentObserver):
    """Its outlook is the emulated rig's truth, up to the outline's harmonics that the explorer can foresee with."""

    name = "clairvoyant"
    foresees = True
    world: World
    touched: Callable[[], Bools]

    def outlook(self, t: float) -> Outlook:
        """The object as it is at `t` (s), without any doubt, and what the palms have really touched of it.

        Asked only once `world` and `touched`, which marks the bins of outward normals, are there.
        """
        return Outlook(t, true_state(self.world)[None], self.touched().copy(), np.zeros(BINS), self.object_count)


def true_state(world: World) -> FloatArray:
    """What is on the palms, as a state of `model.shape_map` (SI)."""
    now: dict[str, Any] = world.truth()
    body = world.object_truth()
    state = np.zeros(shape_map.N)
    state[Z.PSI], state[Z.OMEGA0] = now["psi_rad"], now["omega0_rad_s"]
    state[Z.LN_RHO], state[Z.MU] = math.log(body["rho_m"]), body["mu"]
    state[Z.LN_DITHER], state[Z.DAMPING] = math.log(body["dither_m_s"]), body["damping_m2_s"]
    state[Z.SHAPE :] = coefficients_of(np.array(body["h_m"]))
    return state
