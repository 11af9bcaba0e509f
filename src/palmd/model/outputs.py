"""The named outputs that all observers' kernels share, and the layout of the rig inputs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from palmd.events import FloatArray
from palmd.model.contact import Contact, centre_of_mass, readings, tangent
from palmd.model.dynamics import VIBRATION_ERROR_INPUTS, BodyConstants, Palms, newton_euler
from palmd.model.symbolic import SX, ca
from palmd.model.touch import Touch
from palmd.system.description import RigDescription
from palmd.system.mechanism import BENDS, CONTACTS, FORCES, JOINT_RATES, JOINTS, OPENING, RADII

NAMED = (
    *RADII, "omega0", *CONTACTS, *chain(*zip(JOINTS, JOINT_RATES, strict=True)), "rho",
    "psi", *BENDS, "mu", *FORCES, "com_x", "com_y",
)  # fmt: skip
"""Names as in `events.Estimate`, SI; forces are per unit mass (m/s²), the centre of mass is in the world frame."""

FRICTION_INPUT, CURVATURE_INPUTS = 4, slice(5, 7)
"""Indices of the friction asymmetry and of the palms' curvatures among the kernels' rig inputs."""
RIG_INPUTS = VIBRATION_ERROR_INPUTS.stop


def rig_inputs(rig: RigDescription) -> FloatArray:
    """Return the kernels' rig inputs: g, hinge arm (0 if fixed), base x, y, friction asymmetry (0), curvatures, κ, λ,
    flag of the averaged friction law, 1/(2f) of the vibration, and four errors of the vibration's constants (0).

    They are inputs rather than constants, so that one compiled library serves every rig with flat palms, and a second
    one every rig with curved palms.
    """
    base, arm = rig.arc
    vibration = rig.vibration
    law = vibration.kappa, vibration.nominal_transmission, float(vibration.averaged)
    return np.array([rig.gravity, arm, *base, 0.0, *rig.curvatures, *law, vibration.half_period, 0.0, 0.0, 0.0, 0.0])


def touch_on(rig: SX, curved: bool, near: Sequence[SX] = ()) -> Touch:
    """Return the contact search for these rig inputs: on arcs if `curved`, starting from `near`; else on flat palms."""
    return Touch(ca.vertsplit(rig[CURVATURE_INPUTS]), near) if curved else Touch()


def named_outputs(palms: Palms, omega0: SX, psi: SX, one: Contact, two: Contact, body: BodyConstants, rig: SX) -> SX:
    """Return the values of `NAMED`, in that order."""
    motion = newton_euler(palms, omega0, one, two, body, rig)
    hinge = rig[2:4] - rig[1] * tangent(palms.angles[0], 1)
    com = hinge + centre_of_mass(*palms.angles, one, two)
    return ca.vertcat(
        one.r, two.r, omega0, *readings(palms.angles[OPENING], one, two),
        *chain(*zip(palms.angles, palms.rates, strict=True)), body.rho,
        psi, one.v, two.v, body.mu, *motion.forces, com,
    )  # fmt: skip
