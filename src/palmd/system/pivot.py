"""The pivoting grasp: an object that turns freely about a pivot P in a gripper, dragged by an arm over one pad.

The pad lies along world x at height 0; P is at (X, z), the contact is at X + e. ψ is the body's orientation,
θ = −π/2 − ψ the outward normal at the contact in the body's frame, h_P the support function about P: z = h_P(θ),
e = h_P′(θ). SI units.
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
    """Measured position of the pivot: x from the pad's zero, z over the pad (m); z is None if it is not measured.

    Velocities (m/s) and accelerations (m/s²) are the motion plan's, None without a plan.
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
    """The rig as an observer knows it.

    vertical: `rigid` if the gripper's height is commanded; `float` if it is on a vertical slide, a carriage of
    `carriage_mass` (kg) with `carriage_damping` (N s/m) that rests on the body by its weight. arm_noise: 1σ of a
    measured position (m). angle_sd: 1σ of the pad's slope along x (rad); `pad` has the 1σ of the other constants.
    vibration: of the pad along itself.
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
        """The same rig with these `_sd`, as in `RigDescription.known_to`; unknown names are ignored."""
        of_pad = {name: sd for name, sd in sds.items() if hasattr(PadSensor, name)}
        return replace(self, pad=replace(self.pad, **of_pad), angle_sd=sds.get("angle_sd", self.angle_sd))


def normal_of(psi: FloatArray) -> FloatArray:
    """θ: direction of the outward normal at the contact, in the body's frame, at orientation ψ (rad)."""
    normal: FloatArray = -0.5 * math.pi - psi
    return normal


SYSTEM = "pivot"
AXES = ("x", "z")
"""Names of the gripper's joints: along the pad and over it, both in metres."""
PAD = 1
"""Number of the only pad."""
NAMING = Naming(AXES, "m", (PAD,))


@dataclass(frozen=True, slots=True)
class PivotEstimate(LiveEstimate):
    """Estimate of a pivoting grasp at one instant `t`; SI units, NaN for no value.

    x, z: of the pivot. s: contact on the pad; e = s − x. psi, omega0: the body's orientation, 0 at the first reading
    that was used, and its rate. f: the pad's normal force. moment: mass times distance of the centre of mass from the
    pivot (kg m). side: the sign of e, 0 without contact. touched: fraction of all normals that were touched. reason:
    why it is not valid, in words. sd: 1σ of each field that it names.
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
    """A smoother's estimate from all readings until `t` (s) if `accepted`; else `reason` and `reason_code` say why not.

    p: (CONSTANTS,) of `model.pivot`, with covariance. psi: the orientation at `t` (rad). h_sd: (360,) 1σ of the outline
    without its gauge, and `touched` (360,). Arrays are empty if it is not accepted.
    """

    t: float
    accepted: bool
    reason: str
    psi: float
    p: FloatArray
    covariance: FloatArray
    h_sd: FloatArray
    touched: FloatArray
    reason_code: str = ""


@dataclass(frozen=True, slots=True)
class Touching:
    """Measured contact at `t` (s), without a model, for planning drags.

    x, z: position of the pivot (m). e: contact ahead of the pivot (m), and force (N), means over some tens of
    milliseconds; NaN without contact. touched: fraction of normals touched, and band: RMS 1σ of the outline there (m);
    both NaN without an accepted outline. t_answer: time of the last reading in the smoother's latest answer, accepted
    or not (s); −inf without one, inf if none is to be awaited.
    """

    t: float
    x: float
    z: float
    e: float
    force: float
    touching: bool
    touched: float
    band: float
    t_answer: float = math.inf
