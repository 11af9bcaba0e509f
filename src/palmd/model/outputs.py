"""The named state and what follows from it: the one list of outputs that every observer's kernels share."""

from __future__ import annotations

import numpy as np

from palmd.events import FloatArray
from palmd.model.contact import Contact, centre_of_mass, readings, tangent
from palmd.model.dynamics import BodyConstants, Palms, newton_euler
from palmd.model.symbolic import SX, ca
from palmd.model.touch import Touch
from palmd.system.description import RigDescription

NAMED = (
    "r1", "r2", "omega0", "s1", "s2", "phi1", "omega1", "phi2", "omega2", "rho",
    "psi", "v1", "v2", "mu", "f1", "f2", "com_x", "com_y",
)  # fmt: skip
"""Names as in `events.Estimate`, SI; f1, f2 here are per unit mass (m/s²), COM in the world frame."""

FRICTION_INPUT, CURVATURE_INPUTS = 4, slice(5, 7)
"""Where the friction asymmetry and the palms' curvatures are among what the kernels are told of the rig."""
RIG_INPUTS = 7


def rig_inputs(rig: RigDescription) -> FloatArray:
    """What the kernels are told of the rig: g, hinge arm (0 if fixed), base x, y, friction asymmetry (0), curvatures.

    Inputs rather than constants, so that one compiled library serves every rig, and a second one all with curved palms.
    """
    base, arm = rig.arc
    return np.array([rig.gravity, arm, *base, 0.0, *rig.curvatures])


def touch_on(rig: SX, curved: bool) -> Touch:
    """How contacts are found on a rig of these inputs: on its arcs where `curved`, else on flat palms."""
    return Touch(ca.vertsplit(rig[CURVATURE_INPUTS])) if curved else Touch()


def named_outputs(palms: Palms, omega0: SX, psi: SX, one: Contact, two: Contact, body: BodyConstants, rig: SX) -> SX:
    """Values of `NAMED`, in that order."""
    s1, s2 = readings(palms.phi2, one, two)
    motion = newton_euler(palms, omega0, one, two, body, rig)
    hinge = rig[2:4] - rig[1] * tangent(palms.phi1, 1)
    com = hinge + centre_of_mass(palms.phi1, palms.phi2, one, two)
    return ca.vertcat(
        one.r, two.r, omega0, s1, s2, palms.phi1, palms.omega1, palms.phi2, palms.omega2, body.rho,
        psi, one.v, two.v, body.mu, motion.f1, motion.f2, com,
    )  # fmt: skip
