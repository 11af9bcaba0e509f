"""The rig as observers know it: gravity, the hinge, and each palm's pad with how well it reads. SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from palmd.events import FloatArray
from palmd.system.mechanism import JOINTS, PALMS
from palmd.system.vibration import INDEPENDENT, Vibration

# An actuator that lags by some 20 ms makes of goals rounded by e, one each 10 ms, rates of e over so long.
ROUNDING_LASTS_S = 0.03
# By friction an object's spin follows the palms' rates within 10 ms: a density of so much a second of their square.
UNEVEN_SPIN_HZ = 12.0
HingeMode = Literal["arc", "fixed"]


MAP_SD_M, MAP_LENGTH_M = 7e-5, 3e-3
"""What a calibration leaves of a pad's smooth error of place: one-sigma, and correlation length where none is given
(too short costs 2 %, too long claims too much)."""


@dataclass(frozen=True, slots=True)
class PadSensor:
    """The pad of one palm: how far it reaches from the hinge, its noise, and how well its constants are known.

    curvature: of the palm that it lies on (1/m): > 0 a concave cradle, 0 flat, < 0 a dome.

    The `_sd` are one-sigma of what each constant is off by: `zero` and `scale` of the readings, `standoff` of its
    surface from the hinge line, `sagitta` of its bow, `lag` of its time stamps, `force` of what a reading moves by with
    the contact's force (m/N). By default it is exactly as described.

    map_sd, map_length: what is left of the pad's smooth error of place: one-sigma and length of its squared-exponential
    correlation (m), the latter about a sixth of a wavelength; it is the same whenever the same place is touched.
    map_noise: what that counts for as noise of each reading, a part of `noise` (m).

    stamp_sd: one-sigma of each time stamp by itself (s), as where an adapter delivers readings in batches. blur: what
    that makes of a reading on average, a part of `noise` (m).
    """

    length: float = 0.0555
    noise: float = 1e-4
    resolution: float = 1.27e-4
    force_scale_std: float = 0.05  # relative, of each reading by itself
    force_gain_std: float = 0.0  # relative, of all readings together; it may drift
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
        """Of one contact reading: its noise and what rounding to the resolution adds (m²)."""
        return self.noise**2 + self.resolution**2 / 12

    def force_variance(self, force: FloatArray | float) -> FloatArray | float:
        """Of readings of a true `force` (N) by themselves, rounding included; without what a gain adds (N²)."""
        return (self.force_scale_std * force) ** 2 + self.force_resolution**2 / 12


@dataclass(frozen=True, slots=True)
class RigDescription:
    """What an observer must know of the rig; by default it is exactly as described.

    pads: one for each palm. base: of palm 1's far end, where an arc hinge is fixed to the world. palm_angle_noise: of a
    reported angle by itself. goal_rounding: to what steps set-points are rounded, which the palms follow (rad).
    angle_sd, gravity_sd: one-sigma of what each palm's angle and gravity's direction are off by, all along.
    friction_sd: of the asymmetry (μ1 − μ2)/(μ1 + μ2) of the palms' friction. vibration: of the palms along themselves.
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
        """Centre (m, world) and radius (m) of the hinge's way, for `hinge_position`; (0, 0) and 0 if it is fixed."""
        return (self.base, self.palm1_length) if self.hinge == "arc" else ((0.0, 0.0), 0.0)

    @property
    def curvatures(self) -> tuple[float, ...]:
        """Of each palm (1/m, > 0 concave)."""
        return tuple(pad.curvature for pad in self.pads)

    @property
    def curved(self) -> bool:
        """Whether a palm is not flat."""
        return any(self.curvatures)

    @property
    def reading_variances(self) -> FloatArray:
        """Of one contact reading of each pad (m²)."""
        return np.array([pad.reading_variance for pad in self.pads])

    def force_variances(self, force: FloatArray, pad: FloatArray) -> FloatArray:
        """`PadSensor.force_variance` of readings of true forces (N), each of the pad of that number (N²)."""
        variance = np.empty_like(force)
        for number, sensor in zip(PALMS, self.pads, strict=True):
            mine = pad == number
            variance[mine] = sensor.force_variance(force[mine])
        return variance

    @property
    def uneven(self) -> FloatArray:
        """One-sigma of what rounded goals make of the joints' angles (rad) and rates (rad/s) beside what is told.

        (2, joints): φ1 is of the first palm alone, each further joint from palm to palm.
        """
        of_palm = np.array([1.0, 1.0 / ROUNDING_LASTS_S]) * self.goal_rounding / math.sqrt(12.0)
        return np.outer(of_palm, np.where(np.arange(len(JOINTS)) > 0, math.sqrt(2.0), 1.0))

    @property
    def unequal_friction(self) -> bool:
        """Whether palms that may rub unequally turn that into motion, as a fixed hinge does."""
        return self.hinge == "fixed" and self.friction_sd > 0.0

    @property
    def uneven_spin(self) -> float:
        """What that makes of an object's spin, which follows the palms at once: its noise density ((rad/s)²/s)."""
        return float(UNEVEN_SPIN_HZ * self.uneven[1, 0] ** 2)

    def with_pads(self, **values: float) -> RigDescription:
        """The same rig with these fields of every pad."""
        return replace(self, pads=tuple(replace(pad, **values) for pad in self.pads))

    def known_to(self, sds: Mapping[str, float]) -> RigDescription:
        """The same rig with these `_sd`, which are those of every pad where they are a pad's."""
        of_pads = {name: sd for name, sd in sds.items() if hasattr(PadSensor, name)}
        own: dict[str, Any] = {name: sd for name, sd in sds.items() if name not in of_pads}
        return replace(self.with_pads(**of_pads), **own)

    def known_as(self, other: RigDescription) -> RigDescription:
        """The same rig with the `_sd` of another, each pad's own."""

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
"""How well a rig is known after docs/start/calibration.md."""

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
"""How a log calls the `_sd` of `RigDescription` and `PadSensor`."""
