"""The rig as observers know it: gravity, the hinge, and each palm's pad with its accuracy. SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from palmd.events import FloatArray
from palmd.system.mechanism import JOINTS, PALMS
from palmd.system.vibration import INDEPENDENT, Vibration

ROUNDING_S = (
    0.03  # set-points rounded by e, one per 10 ms, cause rates of e/ROUNDING_S with an actuator lag of some 20 ms
)
ROUNDING_SPIN_HZ = 12.0  # noise density of an object's spin per squared rate error; it follows the palms within 10 ms
HingeMode = Literal["arc", "fixed"]


MAP_SD_M, MAP_LENGTH_M = 7e-5, 3e-3
"""Smooth error of a pad's readings that remains after calibration: standard deviation, and default correlation length
(too short costs 2 %, too long makes estimates over-confident)."""


@dataclass(frozen=True, slots=True)
class PadSensor:
    """The pad of one palm: its length from the hinge, its noise, and how accurately its constants are known.

    curvature: of the palm that it lies on (1/m): > 0 concave, 0 flat, < 0 convex.

    The `_sd` are standard deviations of each constant's error: `zero` and `scale` of the readings, `standoff` of its
    surface from the hinge line, `sagitta` of its bow, `lag` of its time stamps, `force` of a reading's shift with the
    contact's force (m/N). By default the pad is exactly as described.

    map_sd, map_length: the pad's remaining smooth error of position: standard deviation, and length of its
    squared-exponential correlation (m), about a sixth of a wavelength; the error is the same whenever the same point is
    touched. map_noise: the part of `noise` (m) that accounts for this error in each reading.

    stamp_sd: standard deviation of each time stamp's own error (s), for example if an adapter delivers readings in
    batches. blur: the part of `noise` (m) that accounts for it on average.
    """

    length: float = 0.0555
    noise: float = 1e-4
    resolution: float = 1.27e-4
    force_scale_std: float = 0.05  # relative, independent for each reading
    force_gain_std: float = 0.0  # relative, common to all readings; may drift
    force_resolution: float = 0.02
    zero_sd: float = 0.0
    scale_sd: float = 0.0
    standoff_sd: float = 0.0
    sagitta_sd: float = 0.0
    lag_sd: float = 0.0
    force_sd: float = 0.0
    curvature: float = 0.0
    map_sd: float = 0.0
    map_length: float = MAP_LENGTH_M
    map_noise: float = 0.0
    stamp_sd: float = 0.0
    blur: float = 0.0

    @property
    def reading_variance(self) -> float:
        """Variance of a contact reading: noise and rounding to the resolution (m²)."""
        return self.noise**2 + self.resolution**2 / 12

    def force_variance(self, force: FloatArray | float) -> FloatArray | float:
        """Variance of readings of a true `force` (N), rounding included, common gain error not included (N²)."""
        return (self.force_scale_std * force) ** 2 + self.force_resolution**2 / 12


@dataclass(frozen=True, slots=True)
class RigDescription:
    """The rig as an observer knows it; by default exactly as described.

    pads: one per palm. base: far end of palm 1, at which an arc hinge is fixed to the world. palm_angle_noise: of each
    reported angle. goal_rounding: step to which set-points, which the palms follow, are rounded (rad). angle_sd,
    gravity_sd: standard deviations of the constant errors of each palm's angle and of gravity's direction. friction_sd:
    of the asymmetry (μ1 − μ2)/(μ1 + μ2) of the palms' friction. vibration: of the palms along themselves.
    """

    gravity: float = 9.81
    hinge: HingeMode = "arc"
    palm1_length: float = 0.12
    base: tuple[float, float] = (0.12, 0.0)
    palm_angle_noise: float = 2e-4
    goal_rounding: float = 0.0
    angle_sd: float = 0.0
    gravity_sd: float = 0.0
    friction_sd: float = 0.0
    pads: tuple[PadSensor, ...] = tuple(PadSensor() for _ in PALMS)
    vibration: Vibration = INDEPENDENT

    @property
    def arc(self) -> tuple[tuple[float, float], float]:
        """Centre (m, world) and radius (m) of the hinge's path, for `hinge_position`; (0, 0) and 0 if it is fixed."""
        return (self.base, self.palm1_length) if self.hinge == "arc" else ((0.0, 0.0), 0.0)

    @property
    def curvatures(self) -> tuple[float, ...]:
        """Curvature of each palm (1/m, > 0 concave)."""
        return tuple(pad.curvature for pad in self.pads)

    @property
    def curved(self) -> bool:
        """Whether a palm is not flat."""
        return any(self.curvatures)

    @property
    def reading_variances(self) -> FloatArray:
        """Variance of a contact reading of each pad (m²)."""
        return np.array([pad.reading_variance for pad in self.pads])

    def force_variances(self, force: FloatArray, pad: FloatArray) -> FloatArray:
        """`PadSensor.force_variance` of readings of true forces (N), each of the pad with that number (N²)."""
        variance = np.empty_like(force)
        for number, sensor in zip(PALMS, self.pads, strict=True):
            mine = pad == number
            variance[mine] = sensor.force_variance(force[mine])
        return variance

    @property
    def rounding_sd(self) -> FloatArray:
        """Standard deviation of the joints' angles (rad) and rates (rad/s) due to rounded set-points.

        (2, joints): φ1 depends on the first palm alone, each further joint on two palms.
        """
        of_palm = np.array([1.0, 1.0 / ROUNDING_S]) * self.goal_rounding / math.sqrt(12.0)
        return np.outer(of_palm, np.where(np.arange(len(JOINTS)) > 0, math.sqrt(2.0), 1.0))

    @property
    def unequal_friction(self) -> bool:
        """Whether unequal friction of the palms causes motion, as with a fixed hinge."""
        return self.hinge == "fixed" and self.friction_sd > 0.0

    @property
    def rounding_spin_density(self) -> float:
        """Noise density of an object's spin due to rounded set-points, which it follows at once ((rad/s)²/s)."""
        return float(ROUNDING_SPIN_HZ * self.rounding_sd[1, 0] ** 2)

    def with_pads(self, **values: float) -> RigDescription:
        """The same rig with these fields in every pad."""
        return replace(self, pads=tuple(replace(pad, **values) for pad in self.pads))

    def known_to(self, sds: Mapping[str, float]) -> RigDescription:
        """The same rig with these standard deviations; those of pads apply to every pad."""
        of_pads = {name: sd for name, sd in sds.items() if hasattr(PadSensor, name)}
        own: dict[str, Any] = {name: sd for name, sd in sds.items() if name not in of_pads}
        return replace(self.with_pads(**of_pads), **own)

    def known_as(self, other: RigDescription) -> RigDescription:
        """The same rig with the standard deviations of another, pad by pad."""

        def sds(of: RigDescription | PadSensor) -> dict[str, Any]:
            return {name: getattr(of, name) for name in CALIBRATION_KEYS if hasattr(of, name)}

        pads = tuple(replace(mine, **sds(theirs)) for mine, theirs in zip(self.pads, other.pads, strict=True))
        return replace(self, pads=pads, **sds(other))


AS_CALIBRATED: Mapping[str, float] = {
    "zero_sd": 1e-4,
    "scale_sd": 3e-3,
    "angle_sd": math.radians(0.1),
    "standoff_sd": 2e-4,
    "lag_sd": 2e-3,
    "gravity_sd": math.radians(0.2),
    "sagitta_sd": 3e-5,
    "force_sd": 5e-5,
    "friction_sd": 0.3,
}
"""Accuracy of a rig calibrated according to docs/start/calibration.md."""

CALIBRATION_KEYS = {
    "zero_sd": "zero_m",
    "scale_sd": "scale",
    "angle_sd": "angle_rad",
    "standoff_sd": "standoff_m",
    "lag_sd": "lag_s",
    "gravity_sd": "gravity_rad",
    "sagitta_sd": "sagitta_m",
    "friction_sd": "friction",
    "force_sd": "force_m_per_n",
    "map_sd": "map_m",
}
"""Names in event logs of the `_sd` fields of `RigDescription` and `PadSensor`."""
