"""Data types of the estimation: measured events into an observer, estimates out of it.

All are immutable values in SI units. Times are seconds on one monotonic clock (on a live rig) or the log's clock (in a
replay); no pure code reads a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Self

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Joints = tuple[float, ...]
"""One value per joint, in their order."""
ObserverName = Literal["shape", "extended", "quasistatic"]
"""The observers, the default one first."""


@dataclass(frozen=True, slots=True)
class PadSample:
    """One contact reading: the object touches palm `pad` at distance `s` (m, > 0) from the hinge.

    `force` is the contact's normal force (N), None if the pad measures none. `across` is the contact's other coordinate
    (m), None for pads that read one. `at_least`: the pad's full scale (N) if the reading is saturated; the force is at
    least that, and `force` is None.
    """

    t_sample: float
    pad: int
    s: float
    force: float | None = None
    across: float | None = None
    at_least: float | None = None


@dataclass(frozen=True, slots=True)
class PadLift:
    """The object has left palm `pad`; the contact is unknown until the next `PadSample` of that pad."""

    t_sample: float
    pad: int


@dataclass(frozen=True, slots=True)
class PalmSample:
    """Measured joint angles (rad), with the motion plan's rates (rad/s) and accelerations (rad/s²).

    In the order of `system.mechanism.JOINTS`. Rates and accelerations of all joints are None if no plan is known; the
    observer then estimates the rates from the angles.
    """

    t_sample: float
    angles: Joints
    rates: Joints | None = None
    accelerations: Joints | None = None

    @property
    def values(self) -> Joints:
        """All numbers of the sample."""
        return (*self.angles, *(self.rates or ()), *(self.accelerations or ()))


Event = PadSample | PadLift | PalmSample


class PalmMotion(NamedTuple):
    """Joint angles (rad), rates (rad/s) and accelerations (rad/s²) at one instant of a motion.

    A tuple, because simulations make thousands of them per second: a frozen dataclass takes three times as long to
    construct.
    """

    angles: Joints
    rates: Joints
    accelerations: Joints

    @classmethod
    def at_rest(cls, angles: Joints) -> PalmMotion:
        """At rest at these joint angles (rad)."""
        zeros = (0.0,) * len(angles)
        return cls(angles, zeros, zeros)


@dataclass(frozen=True)
class LiveEstimate:
    """An observer's estimate for one instant `t`, of any system, with its uncertainty.

    SI units; NaN means "no value". `sd` holds the standard deviation of each field that it names.
    """

    t: float
    valid: bool
    observer: str
    object_count: int
    nis: float
    sd: dict[str, float] = field(default_factory=dict, kw_only=True)
    invalid_reasons: tuple[str, ...] = field(default=(), kw_only=True)
    """Codes of the reasons why it is invalid, empty if it is valid."""


@dataclass(frozen=True)
class Estimate(LiveEstimate):
    """The estimate for two palms: the named state and quantities derived from it.

    If `valid`, the named state, psi and their standard deviations are finite. Without slots, for `of`.
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
        """Construct from all fields but `e_f` and `e_c`, in a tenth of the time of the dataclass constructor."""
        estimate = object.__new__(cls)
        estimate.__dict__.update(fields)
        return estimate


@dataclass(frozen=True, slots=True)
class ShapeEstimate:
    """The outline as support function h (m) about the centre of mass, on normals theta (rad).

    For a body in space theta are unit vectors (n, 3). h_sd is the standard deviation of h.

    theta is the outward normal's direction in the object frame, whose gauge is psi = 0 at the first fused measurement,
    or that of the stored outline used; `touched` marks the normals at which a palm has been in contact.
    """

    t: float
    theta: FloatArray
    h: FloatArray
    h_sd: FloatArray
    touched: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Improvement:
    """A smoother's estimate of the shape map's state at time `t` (s): mean x, and covariance P given `rig`.

    rig, rig_sd: (15,) the rig constants as in `model.smoothing.R` and their standard deviations. spread: (n + 15, 15),
    their uncertainty as independent 1σ steps: the change of the state due to each step, so that spread·spreadᵀ adds to
    P, followed by the change of the constants. contradicted: (15,) number of σ by which each constant deviates from its
    description, 0 where nothing contradicts it. The outline has the smoother's harmonics. `frame` changes with the
    gauge. `established`: confirmed for so long that no rival hypothesis needs to be kept. touched: (72,) as in
    `PlanningBelief`.
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
    """A smoother's result that no smooth outline explains the readings of an object up to time `t` (s)."""

    t: float


DECIDED = 0.95
"""Probability above which the object is reported as identified."""


@dataclass(frozen=True, slots=True)
class ObjectEstimate:
    """Probability that the object is each of the stored outlines `names`, and that it is none of them; they sum to 1.

    `object_count` is that of the estimate at the same time `t` (s).
    """

    t: float
    names: tuple[str, ...]
    probability: FloatArray
    none: float
    object_count: int

    @property
    def best(self) -> str:
        """The name whose probability is at least `DECIDED`, empty if there is none."""
        likeliest = int(np.argmax(self.probability))
        return self.names[likeliest] if self.probability[likeliest] >= DECIDED else ""


@dataclass(frozen=True, slots=True)
class PlanningBelief:
    """Belief about the object at time `t` (s), for planning motions.

    states: (K, 21) of `model.shape_map`, SI, the likeliest first, then samples of the posterior, all in the gauge of
    the first. touched, h_sd: (72,) for bins of outward normals, bin 0 beginning at θ = 0: whether a palm has been in
    contact, and the outline's standard deviation (m) at the bin's middle. `object_count` as in the estimate. rig:
    errors of the rig constants, in the order of `model.smoothing.R`; None: unknown. rig_spread: (40, 15) their
    uncertainty as in `Improvement`: the change of the outline's 25 coefficients due to each step, then of the
    constants; None until a smoother has confirmed the outline. mass, mass_sd: as measured by the pads (kg), NaN if
    unknown.
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
        """Whether `touched` is final: not before a smoother beside the observer has confirmed the outline."""
        return self.rig is None or self.rig_spread is not None
