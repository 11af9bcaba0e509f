"""Configuration and plans of a rig of three palms: three pads that read both coordinates, an arm with three joints."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, FiniteFloat, Tag, ValidationInfo, field_validator

from palmd.config.any_config import AnyConfig
from palmd.config.arms import AdeptConfig
from palmd.config.fields import AngleRange, Plausible, Positive, Strict
from palmd.config.guards import ForceLimits, JointFollowingError, PadForces, known_pads
from palmd.config.pads import AnyPads, VersaPadConfig
from palmd.config.plans import AnyPlanSpec, Duration, ExploreGoal, ExploreSpec, JointValues, SwingFrequency, one_key_of
from palmd.config.vibration import VibrationConfig, vibration_of
from palmd.system.three_palms import MECHANISM, PALMS, RELATIONS, SYSTEM, PadPlane, ThreePalmsRig


class ThreePalmsRigConfig(Strict):
    """The mechanism and gravity."""

    system: Literal["three_palms"]
    """Kind of rig."""
    mechanism: Literal["edge-axis"] = MECHANISM
    """Mechanism: palm 1 tilts about its edge, palms 2 and 3 turn about the axis along its normal."""
    gravity_m_s2: Annotated[FiniteFloat, Field(gt=0, le=30), Plausible(0.1, 12)] = 9.81
    """Gravity, vertical."""
    angle_noise_deg: Annotated[Positive, Field(le=1), Plausible(0.001, 0.2)] = 0.015
    """Standard deviation of the noise of a joint's reported angle."""
    vibration: VibrationConfig = VibrationConfig()
    """Vibration of each palm along its pad's a, independent of the others; omitted values are unknown."""
    imperfections: Annotated[Literal["none"], Field(exclude=True)] = "none"
    """For the emulated rig only: always `none`, since the observer assumes an exactly known rig."""

    @field_validator("vibration")
    @classmethod
    def _independent(cls, vibration: VibrationConfig) -> VibrationConfig:
        if vibration.relation not in RELATIONS:
            raise ValueError(f"relation must be {' or '.join(RELATIONS)}: other phases of three palms are not modelled")
        return vibration


class PlanePadConfig(VersaPadConfig):
    """A VersaPad that reads both coordinates: b from the apex along its `axis`, and a across."""

    zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = 37.5
    """b at which the pad counts 0 along its `axis`."""
    across_zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = 37.5
    """a at which the pad counts 0 across."""
    across_sign: Literal[1, -1] = 1
    """1 if the counts across increase with a."""
    length_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(10, 500)] = 75.0
    """Side of its sensitive square; across, the count 0 is in the middle."""

    @property
    def across(self) -> tuple[float, int]:
        """The configured zero (mm) and sign across."""
        return self.across_zero_mm, self.across_sign


class ThreePadsConfig(AnyPads):
    """The touch pads, one on each palm."""

    palm1: PlanePadConfig
    """The pad of palm 1: a along the edge about which it tilts."""
    palm2: PlanePadConfig
    """The pad of palm 2: a away from the axis about which it turns."""
    palm3: PlanePadConfig
    """The pad of palm 3, likewise."""

    @property
    def planes(self) -> tuple[PlanePadConfig, ...]:
        """The pads, in the order of their numbers."""
        return (self.palm1, self.palm2, self.palm3)

    @field_validator("*")
    @classmethod
    def _same_kind(cls, pad: PlanePadConfig, info: ValidationInfo) -> PlanePadConfig:
        for palm, other in info.data.items():
            for name in ("length_mm", "noise_mm", "counts_per_mm"):
                if getattr(other, name) != getattr(pad, name):
                    raise ValueError(f"{name} differs from that of {palm}: all pads must be of one kind")
        return pad


class ThreePalmsLimitsConfig(Strict):
    """Limits of the palms' motion."""

    beta_deg: AngleRange = (30.0, 73.0)
    """Range of palm 1's tilt from the horizontal."""
    gamma2_deg: AngleRange = (25.0, 67.0)
    """Range of palm 2's angle about the axis."""
    gamma3_deg: AngleRange = (25.0, 67.0)
    """Range of palm 3's angle about the axis."""
    rate_deg_s: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(1, 360)] = 90.0
    """Maximum rate of each joint."""
    acceleration_deg_s2: Annotated[FiniteFloat, Field(gt=0, le=20000), Plausible(10, 5000)] = 400.0
    """Maximum acceleration of each joint."""
    stop_deceleration_deg_s2: Annotated[FiniteFloat, Field(gt=0, le=20000), Plausible(10, 5000)] | None = 400.0
    """Deceleration of each joint when the motion is held; larger ones make the body leave the palms."""
    following_error: JointFollowingError = JointFollowingError()
    """Largest distance of the joints from their delayed set-points; beyond it the arm is stopped."""
    force_n: ForceLimits | None = None
    """Force on each pad at which the motion is held; default 0.9 of the pad's full scale."""

    @field_validator("force_n")
    @classmethod
    def _own_pads(cls, force_n: float | PadForces | None) -> float | PadForces | None:
        return known_pads(force_n, (f"palm{palm}" for palm in PALMS))

    @property
    def ranges_deg(self) -> tuple[tuple[float, float], ...]:
        """Range of each joint."""
        return (self.beta_deg, self.gamma2_deg, self.gamma3_deg)


class ThreePalmsConfig(AnyConfig):
    """A complete `palmd.yaml` with `rig: {system: three_palms}`."""

    system: ClassVar[str] = SYSTEM

    rig: ThreePalmsRigConfig
    """Mechanism and gravity."""
    pads: ThreePadsConfig
    """The touchpads."""
    arm: AdeptConfig
    """Controller of the joints: x and y on its line are beta and gamma2 in 1/1000 degree, t is gamma3."""
    limits: ThreePalmsLimitsConfig = ThreePalmsLimitsConfig()
    """Limits of the palms' motion."""

    @field_validator("arm")
    @classmethod
    def _without_base(cls, arm: AdeptConfig) -> AdeptConfig:
        defaults = AdeptConfig(port=arm.port)
        names = sorted(name for name in AdeptConfig.model_fields if name.startswith("base_"))
        if based := [name for name in names if getattr(arm, name) != getattr(defaults, name)]:
            raise ValueError(f"{', '.join(based)}: an arm whose axes are the joints has no base; remove it")
        return arm


def three_palms_rig(config: ThreePalmsConfig) -> ThreePalmsRig:
    """Convert the configuration to the observers' description (SI)."""
    pad = config.pads.palm1
    return ThreePalmsRig(
        gravity=config.rig.gravity_m_s2,
        pad=PadPlane(side=pad.length_mm * 1e-3, noise=pad.noise_mm * 1e-3, resolution=1e-3 / pad.counts_per_mm),
        angle_noise=math.radians(config.rig.angle_noise_deg),
        vibration=vibration_of(config.rig.vibration),
    )


# ------------------------------------------------------------------------------------------------------ plans


class TiltAngles(JointValues):
    """Target of the joints; an omitted angle stays unchanged."""

    beta_deg: FiniteFloat | None = None
    """Tilt of palm 1."""
    gamma2_deg: FiniteFloat | None = None
    """Angle of palm 2 about the axis."""
    gamma3_deg: FiniteFloat | None = None
    """Angle of palm 3 about the axis."""


class TiltMoveSpec(Strict):
    """From rest to rest on a minimum-jerk path."""

    move: TiltAngles
    """Target."""
    duration_s: Duration
    """Duration."""


class TiltHoldSpec(Strict):
    """Stand still."""

    hold_s: Duration
    """Duration."""


def _for_all_joints(value: Any) -> Any:
    return value if isinstance(value, list) else [value] * 3


class TiltSineSpec(Strict):
    """Swing about the start pose, with a smooth onset and decay."""

    sine: TiltAngles
    """Amplitudes; 0 if omitted."""
    frequency_hz: Annotated[list[SwingFrequency], Field(min_length=3, max_length=3)] | SwingFrequency
    """Frequency of all joints, or one for each."""
    duration_s: Duration
    """Duration, including onset and decay."""

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Frequency of each joint."""
        return tuple(_for_all_joints(self.frequency_hz))


class TiltGoal(ExploreGoal):
    """When an exploration ends; shares are of all directions."""

    @field_validator("band_mm")
    @classmethod
    def _without_band(cls, band_mm: float | None) -> float | None:
        if band_mm is not None:
            raise ValueError("not supported for three palms: remove it")
        return band_mm


class TiltExploreSpec(ExploreSpec):
    """Closed-loop motion that turns the body to directions not touched yet; swings until there is an estimate."""

    explore: TiltGoal
    """When it ends; must be the last segment."""


TiltSegmentSpec = Annotated[
    Annotated[TiltMoveSpec, Tag("<move>")]
    | Annotated[TiltHoldSpec, Tag("<hold_s>")]
    | Annotated[TiltSineSpec, Tag("<sine>")]
    | Annotated[TiltExploreSpec, Tag("<explore>")],
    one_key_of(("move", "hold_s", "sine", "explore")),
]


class TiltPlanSpec(AnyPlanSpec):
    """Model of the plan file of three palms."""

    segments: Annotated[list[TiltSegmentSpec], Field(min_length=1, max_length=200)]
    """Motions in the order of execution."""
