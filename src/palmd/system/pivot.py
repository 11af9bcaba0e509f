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

from palmd.events import FloatArray, PadSample
from palmd.system.description import PadSensor

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
    slope along x (rad); `pad` has the other constants' one-sigma.
    """

    gravity: float = 9.81
    vertical: Vertical = "rigid"
    z_measured: bool = True
    carriage_mass: float = 0.0
    carriage_damping: float = 0.0
    arm_noise: float = 2e-5
    angle_sd: float = 0.0
    pad: PadSensor = field(default_factory=PadSensor)

    def known_to(self, sds: Mapping[str, float]) -> PivotRig:
        """The same rig with these `_sd`, as in `RigDescription.known_to`; those that it has no place for are left."""
        of_pad = {name: sd for name, sd in sds.items() if hasattr(PadSensor, name)}
        return replace(self, pad=replace(self.pad, **of_pad), angle_sd=sds.get("angle_sd", self.angle_sd))


def normal_of(psi: FloatArray) -> FloatArray:
    """θ: the outward normal, in the body's frame, of the point that touches the pad at orientation ψ (rad)."""
    normal: FloatArray = -0.5 * math.pi - psi
    return normal
