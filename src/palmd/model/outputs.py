"""The named state and what follows from it: the one list of outputs that every observer's kernels share."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from palmd.events import FloatArray
from palmd.model.contact import Contact, centre_of_mass, readings, tangent
from palmd.model.dynamics import VIBRATION_OFF_INPUTS, BodyConstants, Palms, newton_euler
from palmd.model.symbolic import SX, ca
from palmd.model.touch import Touch
from palmd.system.description import RigDescription
from palmd.system.mechanism import BENDS, CONTACTS, FORCES, JOINT_RATES, JOINTS, OPENING, RADII

NAMED = (
    *RADII, "omega0", *CONTACTS, *chain(*zip(JOINTS, JOINT_RATES, strict=True)), "rho",
    "psi", *BENDS, "mu", *FORCES, "com_x", "com_y",
)  # fmt: skip
"""Names as in `events.Estimate`, SI; forces here are per unit mass (m/s²), COM in the world frame."""

FRICTION_INPUT, CURVATURE_INPUTS = 4, slice(5, 7)
"""Where the friction asymmetry and the palms' curvatures are among what the kernels are told of the rig."""
RIG_INPUTS = VIBRATION_OFF_INPUTS.stop


def rig_inputs(rig: RigDescription) -> FloatArray:
    """What the kernels are told of the rig: g, hinge arm (0 if fixed), base x, y, friction asymmetry (0), curvatures,
    κ, λ, whether the old law of friction holds, 1/(2f) of the vibration, and by how much these are off (0).

    Inputs rather than constants, so that one compiled library serves every rig, and a second one all with curved palms.
    """
    base, arm = rig.arc
    vibration = rig.vibration
    law = vibration.kappa, vibration.nominal_transmission, float(vibration.averaged)
    return np.array([rig.gravity, arm, *base, 0.0, *rig.curvatures, *law, vibration.half_period, 0.0, 0.0, 0.0, 0.0])


def touch_on(rig: SX, curved: bool, near: Sequence[SX] = ()) -> Touch:
    """How contacts are found on a rig of these inputs: on its arcs where `curved` (from `near` on), else on flats."""
    return Touch(ca.vertsplit(rig[CURVATURE_INPUTS]), near) if curved else Touch()


def named_outputs(palms: Palms, omega0: SX, psi: SX, one: Contact, two: Contact, body: BodyConstants, rig: SX) -> SX:
    """Values of `NAMED`, in that order."""
    motion = newton_euler(palms, omega0, one, two, body, rig)
    hinge = rig[2:4] - rig[1] * tangent(palms.angles[0], 1)
    com = hinge + centre_of_mass(*palms.angles, one, two)
    return ca.vertcat(
        one.r, two.r, omega0, *readings(palms.angles[OPENING], one, two),
        *chain(*zip(palms.angles, palms.rates, strict=True)), body.rho,
        psi, one.v, two.v, body.mu, *motion.forces, com,
    )  # fmt: skip
