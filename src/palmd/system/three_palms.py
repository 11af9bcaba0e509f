"""Three flat palms in space: the mechanism of the paper's figure 1.2 (`edge-axis`), and the rig as observers know it.

World frame: the apex O of the three palms at the origin, gravity along −z. Palm 1 tilts by β about its bottom edge X
through O; palms 2 and 3 are carried by it and turn by γ2 and γ3 about the axis through O along its normal n1. All three
pass through O, so that a point c on palm i has nᵢ·c = 0. Pure.
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
"""What the joint angles are called, in the order of every joint vector."""
NAMING = Naming(JOINTS, "rad", PALMS, along="b", across="a")
RELATIONS: tuple[Relation, ...] = ("independent", "none")
"""Between the palms' vibrations, of those that there are."""
GAP_S = 0.15
"""Without a reading of a pad or a report of the joints, after which nothing is known to go on."""
_TURNS: FloatArray = np.array([[0.0], [1.0], [-1.0]])
"""How palms turn about n1 with their joint's angle."""
_MIDDLES: FloatArray = np.array([[0.0, 0.5], [0.5, 0.5], [0.5, 0.5]])
"""Of the pads, along both of their axes, in sides."""
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
HALVINGS = 4
"""How often the icosahedron is halved whose corners are the directions of a published surface: 2,562 of them."""


@dataclass(frozen=True, slots=True)
class PadPlane:
    """A pad that reads both coordinates of the contact: its side, noise and resolution (m), noise of force readings.

    `force_scale_std` is relative, of each reading by itself.
    """

    side: float = 0.075
    noise: float = 1e-4
    resolution: float = 1.27e-4
    force_scale_std: float = 0.05

    @property
    def reading_variance(self) -> float:
        """Of one coordinate: its noise and what rounding to the resolution adds (m²)."""
        return self.noise**2 + self.resolution**2 / 12


@dataclass(frozen=True, slots=True)
class ThreePalmsRig:
    """What an observer knows of the rig: gravity (m/s²), the pads, one-sigma of a joint angle (rad), vibration."""

    gravity: float = 9.81
    pad: PadPlane = PadPlane()
    angle_noise: float = 2e-4
    vibration: Vibration = INDEPENDENT

    @property
    def acting(self) -> FloatArray:
        """What the kernels take of it: gravity (m/s²) and λ of the palms' vibration, 1 where it is not known."""
        known = self.vibration.transmission
        return np.array([self.gravity, 1.0 if known is None else known])


@dataclass(frozen=True, slots=True)
class PalmPlanes:
    """Where the palms are and how they turn at T instants; arrays (T, 3 palms, 3), SI, world frame.

    normal: unit normals towards the object, with their first and second time derivatives. spin: angular velocity of
    each palm. axis_a, axis_b: the pad's axes, so that readings (a, b) mean the contact a·axis_a + b·axis_b.
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
    """a × b over the last axis: NumPy's, which is general, takes ten times as long for a few."""
    return np.asarray(a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT], np.float64)


def contact_points(palms: PalmPlanes, a: FloatArray, b: FloatArray) -> FloatArray:
    """(T, 3 palms, 3) contacts (m, world) of readings a, b (T, 3 palms)."""
    points: FloatArray = a[..., None] * palms.axis_a + b[..., None] * palms.axis_b
    return points


def readings_of(palms: PalmPlanes, points: FloatArray) -> FloatArray:
    """(T, 3 palms, 2) what each pad reads of contacts (T, 3 palms, 3) (m, world)."""
    return np.stack([(points * palms.axis_a).sum(-1), (points * palms.axis_b).sum(-1)], axis=-1)


def room_on_pads(readings: FloatArray, side: float) -> FloatArray:
    """(…, 3 palms, 2) how far readings lie within the edges of pads with this `side` (m), negative beyond.

    Palm 1's pad is centred on the edge along its first axis and begins there along its second; the others begin there
    along both.
    """
    room: FloatArray = 0.5 * side - np.abs(readings - side * _MIDDLES)
    return room


@dataclass(frozen=True, slots=True)
class BodyEstimate(LiveEstimate):
    """What is known of a body between three palms at one instant `t`, by the names and units of `palm3/estimate`.

    values: NaN for no value; `sd` has the one-sigma of those that it names. quaternion: x, y, z, w, body to world, or
    NaN; attitude_sd: of turns about the world's axes (rad). touched: share of all directions that were felt.
    hypotheses: how many motions explain the readings. reason: why it is not valid, in words.
    """

    values: Mapping[str, float]
    quaternion: tuple[float, ...]
    attitude_sd: tuple[float, ...]
    touched: float
    hypotheses: int
    reason: str


@dataclass(frozen=True, slots=True)
class BodyPlanningBelief:
    """What is known of a body at time `t` (s), for choosing motions.

    R: (3, 3) body to world, omega (3,) (rad/s), p: (m,) parameters of `model.three_palms`; covariance: (6 + m, 6 + m)
    of turns in the world, omega and p. touched: which of the directions lie within 4 degrees of where a palm has been
    until the smoother's answer; since: (K, 3 palms, 3) outward normals in the body where it has been touched after
    that. `begun` (s) tells records of the body apart. Each has its own frame, in which all is told here; `turn` (3, 3)
    leads from it into that of the first record whose `frame` is the same: by where two of them say it lies. What is
    not `claimed`, or contradicted a little since, is not known to be right. mass: kg, NaN where no force was read.
    """

    t: float
    object_count: int
    begun: float
    claimed: bool
    mass: float
    R: FloatArray
    omega: FloatArray
    p: FloatArray
    covariance: FloatArray
    touched: npt.NDArray[np.bool_]
    since: FloatArray
    frame: int
    turn: FloatArray


@dataclass(frozen=True, slots=True)
class BodyAnswer:
    """A smoother's belief about all that was felt until `t` (s), or in `reason` why it claims nothing.

    begun: where its record begins (s), another after a palm has been let go. R: (3, 3) body to world, omega (3,)
    (rad/s) at `t`, p: (m,) parameters of `model.three_palms`; covariance: (6 + m, 6 + m) of turns in the world, omega
    and p. h, h_sd: the surface (m), its one-sigma, and `touched`, for each of the directions. inertia_sd: (9,) per unit
    mass (m²). mass, mass_sd: kg, NaN where no force was read. rough: what a reading misses all that by besides its
    noise (m), one-sigma: what harmonics leave out. Arrays are empty where no motion is known; where one is but is not
    `claimed`, the belief is told and is not to be believed.
    """

    t: float
    begun: float
    claimed: bool
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
    rough: float = 0.0
