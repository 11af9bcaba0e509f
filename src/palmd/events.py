"""What flows: measured events into an observer, estimates out of it.

Everything here is an immutable value in SI units. Times are seconds on one monotonic clock (on a live rig)
or the log's own clock (on a replay); no code below the rim ever asks what time it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Self

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Joints = tuple[float, ...]
"""One value for each joint, in their order."""
ObserverName = Literal["shape", "extended", "quasistatic"]
"""What observers there are, the usual one first."""


@dataclass(frozen=True, slots=True)
class PadSample:
    """One contact reading: the object touches palm `pad` at distance `s` (m, > 0) from the hinge.

    `force` is the contact's normal force in N, None when the pad gives none. `across` is the contact's other coordinate
    (m), None from pads of which one is read. `at_least`: the pad's full scale (N) where the reading is saturated:
    the force is no less, and `force` is None.
    """

    t_sample: float
    pad: int
    s: float
    force: float | None = None
    across: float | None = None
    at_least: float | None = None


@dataclass(frozen=True, slots=True)
class PadLift:
    """The object has left palm `pad`: no reading is valid until the next `PadSample` of that pad."""

    t_sample: float
    pad: int


@dataclass(frozen=True, slots=True)
class PalmSample:
    """The joint angles as measured (rad), with the motion plan's rates (rad/s) and accelerations (rad/s²).

    In the order of `system.mechanism.JOINTS`. Rates and accelerations are None where no plan is known, of all joints;
    the observer then estimates the rates from the angles alone.
    """

    t_sample: float
    angles: Joints
    rates: Joints | None = None
    accelerations: Joints | None = None

    @property
    def told(self) -> Joints:
        """Every number that it tells of the joints."""
        return (*self.angles, *(self.rates or ()), *(self.accelerations or ()))


Event = PadSample | PadLift | PalmSample


class PalmMotion(NamedTuple):
    """Joint angles (rad), rates (rad/s) and accelerations (rad/s²) at one instant of a motion.

    A tuple, as simulations make thousands of them for each second: a frozen dataclass takes thrice as long to make.
    """

    angles: Joints
    rates: Joints
    accelerations: Joints

    @classmethod
    def at_rest(cls, angles: Joints) -> PalmMotion:
        """Standing at these joint angles (rad)."""
        still = (0.0,) * len(angles)
        return cls(angles, still, still)


@dataclass(frozen=True)
class LiveEstimate:
    """An observer's answer for one instant `t`, of whichever system, and how far to trust it.

    SI units; NaN means "no value". `sd` holds the one-sigma of each field it names, under the same names as here.
    """

    t: float
    valid: bool
    observer: str
    object_count: int
    nis: float
    sd: dict[str, float] = field(default_factory=dict, kw_only=True)
    invalid_reasons: tuple[str, ...] = field(default=(), kw_only=True)
    """Codes of what speaks against it, empty when it is valid."""


@dataclass(frozen=True)
class Estimate(LiveEstimate):
    """That of two palms: the named state and what follows from it.

    With `valid` True the named state, psi and their sd are finite. Without slots, for `of`.
    """

    r1: float
    r2: float
    omega0: float
    s1: float
    s2: float
    phi1: float
    omega1: float
    phi2: float
    omega2: float
    rho: float
    psi: float
    v1: float
    v2: float
    mu: float
    mass: float
    f1: float
    f2: float
    com_x: float
    com_y: float
    observability: float
    touched: float
    e_f: float = math.nan  # of the quasistatic observer: (3.36), m
    e_c: float = math.nan  # and the length of (3.37), m

    @classmethod
    def of(cls, fields: dict[str, Any]) -> Self:
        """With all these fields, `e_f` and `e_c` aside: a tenth of the time that a frozen dataclass's own way takes."""
        made = object.__new__(cls)
        made.__dict__.update(fields)
        return made


@dataclass(frozen=True, slots=True)
class ShapeEstimate:
    """The outline as a support function about the centre of mass: h and its one-sigma (m) on normals theta (rad).

    Of a body in space theta are unit vectors (n, 3).

    theta is the outward normal's direction in the object frame, whose gauge is psi = 0 at the first fused
    measurement, or that of the stored outline it began from; `touched` marks the normals that a palm has been in
    contact with.
    """

    t: float
    theta: FloatArray
    h: FloatArray
    h_sd: FloatArray
    touched: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Improvement:
    """A smoother's belief about the shape map's state at time `t` (s): mean x, and covariance P were `rig` right.

    rig, rig_sd: (15,) the rig's constants as in `model.smoothing.R` and their one-sigma. spread: (n + 15, 15), what is
    not known of them as independent one-sigma steps: what each moves of the state, so that spread·spreadᵀ adds to P,
    and then of the constants themselves. contradicted: (15,) by how many sigmas each is not what it was taken for,
    0 where nothing speaks against it. The outline has the smoother's harmonics. `frame` is another when it has another
    gauge than before. `established`: what was found has proved true for so long that no rival needs to be kept.
    touched: (72,) as in `PlanningBelief`.
    """

    t: float
    x: FloatArray
    P: FloatArray
    frame: int
    established: bool
    touched: npt.NDArray[np.bool_]
    rig: FloatArray
    rig_sd: FloatArray
    spread: FloatArray
    contradicted: FloatArray


@dataclass(frozen=True, slots=True)
class Unexplained:
    """A smoother's word that no smooth outline explains the readings of an object up to time `t` (s)."""

    t: float


DECIDED = 0.95
"""The probability from which on it is said which object it is."""


@dataclass(frozen=True, slots=True)
class ObjectEstimate:
    """Which of the stored outlines `names` the object is: the probability of each, and of none of them.

    They sum to 1. `object_count` is that of the estimate at the same time `t` (s).
    """

    t: float
    names: tuple[str, ...]
    probability: FloatArray
    none: float
    object_count: int

    @property
    def best(self) -> str:
        """The name whose probability is at least `DECIDED`, empty when there is none."""
        likeliest = int(np.argmax(self.probability))
        return self.names[likeliest] if self.probability[likeliest] >= DECIDED else ""


@dataclass(frozen=True, slots=True)
class PlanningBelief:
    """What is known of the object at time `t` (s), for choosing motions.

    states: (K, 21) of `model.shape_map`, SI, the likeliest first, then samples of what the object may be besides, all
    in the first one's gauge. touched, h_sd: (72,) for the bins of outward normals, bin 0 beginning at θ = 0, whether a
    palm has been there and the outline's one-sigma (m) at the bin's middle. `object_count` as in the estimate.
    rig: what the rig's constants are off by, in the order of `model.smoothing.R`; None: nothing is known of it.
    rig_spread: (40, 15) what is not known of them, as of `Improvement`: what each step moves of the outline's 25
    coefficients, then of the constants; None until a smoother vouches for the outline.
    mass, mass_sd: as the pads feel it (kg), NaN while they do not say.
    """

    t: float
    states: FloatArray
    touched: npt.NDArray[np.bool_]
    h_sd: FloatArray
    object_count: int
    rig: FloatArray | None = None
    rig_spread: FloatArray | None = None
    mass: float = math.nan
    mass_sd: float = math.nan

    @property
    def confirmed(self) -> bool:
        """Whether what is said to be touched stays so: not before a smoother beside the observer has found it too."""
        return self.rig is None or self.rig_spread is not None
