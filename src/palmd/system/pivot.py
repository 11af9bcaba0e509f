"""The pivoting grasp: an object held where it turns freely about a pivot P, and dragged by an arm over one pad.

The pad lies along world x at height 0; P is at (X, z), e is how far ahead of P the pad is touched. ψ is the body's
orientation, θ = −π/2 − ψ the outward normal that touches in the body's frame, h_P the support function about P: then
z = h_P(θ), e = h_P′(θ). SI units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from palmd.events import FloatArray, LiveEstimate, PadSample
from palmd.system.description import PadSensor
from palmd.system.naming import Naming
from palmd.system.vibration import INDEPENDENT, Vibration

Vertical = Literal["rigid", "float"]


@dataclass(frozen=True, slots=True)
class GripperSample:
    """Where the pivot is as measured: x from the pad's zero, z over the pad (m); z None where it is not measured.

    Velocities (m/s) and accelerations (m/s²) are the motion plan's, None where no plan tells them.
    """

    t_sample: float
    x: float
    z: float | None
    vx: float | None = None
    ax: float | None = None
    vz: float | None = None
    az: float | None = None


PivotEvent = PadSample | GripperSample


@dataclass(frozen=True, slots=True)
class PivotRig:
    """What an observer must know of the rig.

    vertical: whether the gripper is `rigid` in height or slides, a carriage of `carriage_mass` (kg) with
    `carriage_damping` (N s/m) under its own weight. arm_noise: of each measured position (m). angle_sd: of the pad's
    slope along x (rad); `pad` has the other constants' one-sigma. vibration: of the pad along itself.
    """

    gravity: float = 9.81
    vertical: Vertical = "rigid"
    z_measured: bool = True
    carriage_mass: float = 0.0
    carriage_damping: float = 0.0
    arm_noise: float = 2e-5
    angle_sd: float = 0.0
    pad: PadSensor = field(default_factory=PadSensor)
    vibration: Vibration = INDEPENDENT

    def known_to(self, sds: Mapping[str, float]) -> PivotRig:
        """The same rig with these `_sd`, as in `RigDescription.known_to`; those that it has no place for are left."""
        of_pad = {name: sd for name, sd in sds.items() if hasattr(PadSensor, name)}
        return replace(self, pad=replace(self.pad, **of_pad), angle_sd=sds.get("angle_sd", self.angle_sd))


def normal_of(psi: FloatArray) -> FloatArray:
    """θ: the outward normal, in the body's frame, of the point that touches the pad at orientation ψ (rad)."""
    normal: FloatArray = -0.5 * math.pi - psi
    return normal


SYSTEM = "pivot"
AXES = ("x", "z")
"""What the gripper's joints are called: along the pad and over it, both measured in metres."""
PAD = 1
"""The number of the one pad."""
NAMING = Naming(AXES, "m", (PAD,))


@dataclass(frozen=True, slots=True)
class PivotEstimate(LiveEstimate):
    """What is known of a pivoting grasp at one instant `t`; SI units, NaN for no value.

    x, z: of the pivot. s: where the pad is touched; e = s − x. psi, omega0: the body's orientation, 0 at the first
    reading that was used, and its rate. f: the pad's force. moment: mass times distance of the centre of mass from the
    pivot (kg m). side: the sign of e, 0 while nothing is touched. touched: share of all normals that were felt.
    reason: why it is not valid, in words. sd: one-sigma of each field it names.
    """

    x: float
    z: float
    s: float
    e: float
    psi: float
    omega0: float
    f: float
    mu: float
    moment: float
    side: int
    touched: float
    reason: str


@dataclass(frozen=True, slots=True)
class PivotAnswer:
    """A smoother's belief about all that was felt until `t` (s), or in `reason` why it claims nothing.

    p: (CONSTANTS,) of `model.pivot`, covariance of the same. psi: the orientation at `t` (rad). h_sd: (360,) one-sigma
    of the outline, its gauge left out, and `touched` (360,) where it was felt. Empty arrays where nothing is claimed.
    """

    t: float
    claimed: bool
    reason: str
    psi: float
    p: FloatArray
    covariance: FloatArray
    h_sd: FloatArray
    touched: FloatArray


@dataclass(frozen=True, slots=True)
class Touching:
    """What a gripper that drags must go by at `t` (s), measured and without any model.

    x, z: where the pivot is (m). e: how far ahead of it the pad is touched (m) and force (N), means over some tens of
    milliseconds; NaN while untouched. band: RMS one-sigma of the outline where felt (m), NaN while nothing is claimed.
    """

    t: float
    x: float
    z: float
    e: float
    force: float
    touching: bool
    touched: float
    band: float
