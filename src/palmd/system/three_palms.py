"""Three flat palms in space: the mechanism of the paper's figure 1.2 (`edge-axis`), and the rig as observers know it.

World frame: the apex O of the three palms is the origin, gravity acts along −z. Palm 1 tilts by β about its bottom edge
X through O; palms 2 and 3 are carried by it and turn by γ2 and γ3 about the axis through O along its normal n1. All
three pass through O, so that a point c on palm i has nᵢ·c = 0. Pure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray, LiveEstimate
from palmd.system.naming import Naming
from palmd.system.vibration import INDEPENDENT, Relation, Vibration

SYSTEM = "three_palms"
MECHANISM: Literal["edge-axis"] = "edge-axis"
PALMS = (1, 2, 3)
"""The palms' numbers; palm i carries pad i."""
JOINTS = ("beta", "gamma2", "gamma3")
"""Names of the joint angles, in the order of every joint vector."""
NAMING = Naming(JOINTS, "rad", PALMS, along="b", across="a")
RELATIONS: tuple[Relation, ...] = ("independent", "none")
"""Supported relations between the palms' vibrations."""
GAP_S = 0.15
"""Gap in a pad's readings or the joints' reports after which an estimate is not continued."""
_TURNS: FloatArray = np.array([[0.0], [1.0], [-1.0]])
"""Sense in which each palm turns about n1 with its joint's angle."""
_MIDDLES: FloatArray = np.array([[0.0, 0.5], [0.5, 0.5], [0.5, 0.5]])
"""Middles of the pads along both axes, in units of their side."""
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
HALVINGS = 4
"""Subdivisions of the icosahedron whose vertices are the directions of a published surface: 2,562 of them."""


@dataclass(frozen=True, slots=True)
class PadPlane:
    """A pad that reads both coordinates of the contact: its side, noise and resolution (m), noise of force readings.

    `force_scale_std` is relative, and independent for each reading.
    """

    side: float = 0.075
    noise: float = 1e-4
    resolution: float = 1.27e-4
    force_scale_std: float = 0.05

    @property
    def reading_variance(self) -> float:
        """Variance of one coordinate: noise plus rounding to the resolution (m²)."""
        return self.noise**2 + self.resolution**2 / 12


@dataclass(frozen=True, slots=True)
class ThreePalmsRig:
    """The rig as an observer knows it: gravity (m/s²), the pads, 1σ of a joint angle (rad), vibration."""

    gravity: float = 9.81
    pad: PadPlane = PadPlane()
    angle_noise: float = 2e-4
    vibration: Vibration = INDEPENDENT

    @property
    def kernel_constants(self) -> FloatArray:
        """Kernel inputs: gravity (m/s²) and ripple transmission λ of the palms' vibration, 1 if it is not known."""
        known = self.vibration.transmission
        return np.array([self.gravity, 1.0 if known is None else known])


@dataclass(frozen=True, slots=True)
class PalmPlanes:
    """Pose and motion of the palms at T instants; arrays (T, 3 palms, 3), SI, world frame.

    normal: unit normals towards the object, with their first and second time derivatives. spin: angular velocity of
    each palm. axis_a, axis_b: the pad's axes; a reading (a, b) is the contact a·axis_a + b·axis_b.
    """

    normal: FloatArray
    normal_rate: FloatArray
    normal_acceleration: FloatArray
    spin: FloatArray
    axis_a: FloatArray
    axis_b: FloatArray


def palms_at(angle: FloatArray, rate: FloatArray, acceleration: FloatArray) -> PalmPlanes:
    """The palms for joint angles (rad), rates (rad/s) and accelerations (rad/s²), each (T, 3) = (β, γ2, γ3)."""
    (cos_beta, cos2, cos3), (sin_beta, sin2, sin3) = np.cos(angle).T, np.sin(angle).T
    edge, up, n1 = np.zeros((3, len(angle), 3))
    edge[:, 0] = 1.0
    up[:, 1], up[:, 2] = cos_beta, sin_beta
    n1[:, 1], n1[:, 2] = -sin_beta, cos_beta

    def mixed(along_edge: FloatArray, along_up: FloatArray) -> FloatArray:
        mixture: FloatArray = along_edge[:, None] * edge + along_up[:, None] * up
        return mixture

    normal, axis_a, axis_b = np.empty((3, len(angle), 3, 3))
    normal[:, 0], normal[:, 1], normal[:, 2] = n1, mixed(cos2, sin2), mixed(-cos3, sin3)
    axis_a[:, 0], axis_a[:, 1], axis_a[:, 2] = edge, mixed(-sin2, cos2), mixed(sin3, cos3)
    axis_b[:, 0], axis_b[:, 1], axis_b[:, 2] = up, n1, n1

    tilt, tilting = rate[:, :1] * edge, acceleration[:, :1] * edge
    turn, turning = (each[:, :, None] * _TURNS for each in (rate, acceleration))
    axle = n1[:, None]
    spin = tilt[:, None] + turn * axle
    spin_rate = tilting[:, None] + turning * axle + turn * _cross(tilt, n1)[:, None]
    normal_rate = _cross(spin, normal)
    return PalmPlanes(normal, normal_rate, _cross(spin_rate, normal) + _cross(spin, normal_rate), spin, axis_a, axis_b)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a × b over the last axis; ten times as fast as NumPy's for few vectors."""
    return np.asarray(a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT], np.float64)


def contact_points(palms: PalmPlanes, a: FloatArray, b: FloatArray) -> FloatArray:
    """(T, 3 palms, 3) contacts (m, world) of readings a, b (T, 3 palms)."""
    points: FloatArray = a[..., None] * palms.axis_a + b[..., None] * palms.axis_b
    return points


def readings_of(palms: PalmPlanes, points: FloatArray) -> FloatArray:
    """(T, 3 palms, 2) readings of contacts (T, 3 palms, 3) (m, world)."""
    return np.stack([(points * palms.axis_a).sum(-1), (points * palms.axis_b).sum(-1)], axis=-1)


def room_on_pads(readings: FloatArray, side: float) -> FloatArray:
    """(…, 3 palms, 2) distance of readings from the edges of pads with this `side` (m); negative outside.

    Palm 1's pad is centred on the edge along its first axis and begins there along its second; the others begin there
    along both.
    """
    room: FloatArray = 0.5 * side - np.abs(readings - side * _MIDDLES)
    return room


@dataclass(frozen=True, slots=True)
class BodyEstimate(LiveEstimate):
    """Estimate of a body between three palms at one instant `t`, with the names and units of `palm3/estimate`.

    values: NaN for no value; `sd`: 1σ of the values that it names. quaternion: x, y, z, w, body to world, or NaN;
    attitude_sd: 1σ of turns about the world's axes (rad). touched: fraction of all directions that were touched.
    hypotheses: number of motions that explain the readings. reason: why it is not valid, in words.
    """

    values: Mapping[str, float]
    quaternion: tuple[float, ...]
    attitude_sd: tuple[float, ...]
    touched: float
    hypotheses: int
    reason: str


@dataclass(frozen=True, slots=True)
class BodyPlanningBelief:
    """Belief about a body at time `t` (s) for planning.

    record_start: (s), identifies the record. accepted: whether the smoother's answer was accepted and is not
    contradicted since. mass: kg, NaN without force readings. R: (3, 3) body to world, omega (3,) (rad/s), p: (m,)
    parameters of `model.three_palms`; covariance: (6 + m, 6 + m) of turns in the world, omega and p. touched: which
    directions lie within 4 degrees of a contact before the smoother's answer; normals_since: (K, 3 palms, 3) outward
    normals in the body's frame of contacts since then. Each record has its own body frame, in which everything here is
    given; turn (3, 3) rotates it to the frame of the first record with the same number `frame`.
    """

    t: float
    object_count: int
    record_start: float
    accepted: bool
    mass: float
    R: FloatArray
    omega: FloatArray
    p: FloatArray
    covariance: FloatArray
    touched: npt.NDArray[np.bool_]
    normals_since: FloatArray
    frame: int
    turn: FloatArray


@dataclass(frozen=True, slots=True)
class BodyAnswer:
    """A smoother's estimate from all readings until `t` (s).

    record_start: start of the record (s); a new one begins after a palm lost contact. accepted: whether the estimate
    passed all tests; if not, `reason` and `reason_code` say why, and the estimate is given for information. R: (3, 3)
    body to world, omega (3,) (rad/s) at `t`, p: (m,) parameters of `model.three_palms`; covariance: (6 + m, 6 + m) of
    turns in the world, omega and p. h, h_sd: support function and its 1σ (m), and `touched`, for each direction.
    inertia_sd: (9,) per unit mass (m²). mass, mass_sd: kg, NaN without force readings. unexplained_sd: 1σ of the
    readings' errors beyond their noise, from truncated harmonics (m). Arrays are empty if no motion is known.
    """

    t: float
    record_start: float
    accepted: bool
    reason: str
    hypotheses: int
    R: FloatArray
    omega: FloatArray
    p: FloatArray
    covariance: FloatArray
    h: FloatArray
    h_sd: FloatArray
    touched: FloatArray
    inertia_sd: FloatArray
    mass: float
    mass_sd: float
    unexplained_sd: float = 0.0
    reason_code: str = ""
