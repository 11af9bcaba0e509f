"""The configuration of a rig of three palms in space: three pads that read both coordinates, an arm of three joints."""

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
    """What kind of rig it is."""
    mechanism: Literal["edge-axis"] = MECHANISM
    """How the palms are joined: palm 1 tilts about its edge, palms 2 and 3 turn about the axis along its normal."""
    gravity_m_s2: Annotated[FiniteFloat, Field(gt=0, le=30), Plausible(0.1, 12)] = 9.81
    """Straight down."""
    angle_noise_deg: Annotated[Positive, Field(le=1), Plausible(0.001, 0.2)] = 0.015
    """One sigma of a joint's reported angle by itself."""
    vibration: VibrationConfig = VibrationConfig()
    """Of each palm along its pad's a, independently of the others; left out: nothing else is known."""
    imperfections: Annotated[Literal["none"], Field(exclude=True)] = "none"
    """Of the emulated rig alone: it is as described, for its observer takes a rig to be so."""

    @field_validator("vibration")
    @classmethod
    def _independent(cls, vibration: VibrationConfig) -> VibrationConfig:
        if vibration.relation not in RELATIONS:
            raise ValueError(f"relation must be {' or '.join(RELATIONS)}: no phase between three palms is modelled")
        return vibration


class PlanePadConfig(VersaPadConfig):
    """A VersaPad of which both coordinates are read: b from the apex along its `axis`, and a across."""

    zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = 37.5
    """b of the place where the pad counts 0 along its `axis`."""
    across_zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = 37.5
    """a of the same place."""
    across_sign: Literal[1, -1] = 1
    """1 where the counts across grow with a."""
    length_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(10, 500)] = 75.0
    """The side of the square that it feels, the place where it counts 0 in its middle across."""

    @property
    def across(self) -> tuple[float, int]:
        """As configured."""
        return self.across_zero_mm, self.across_sign


class ThreePadsConfig(AnyPads):
    """The touchpads, one on each palm."""

    palm1: PlanePadConfig
    """The pad of palm 1: a along the edge about which it tilts."""
    palm2: PlanePadConfig
    """The pad of palm 2: a away from the axis about which it turns."""
    palm3: PlanePadConfig
    """The pad of palm 3, likewise."""

    @property
    def planes(self) -> tuple[PlanePadConfig, ...]:
        """They, in the order of their numbers."""
        return (self.palm1, self.palm2, self.palm3)

    @field_validator("*")
    @classmethod
    def _alike(cls, pad: PlanePadConfig, info: ValidationInfo) -> PlanePadConfig:
        for palm, other in info.data.items():
            for name in ("length_mm", "noise_mm", "counts_per_mm"):
                if getattr(other, name) != getattr(pad, name):
                    raise ValueError(f"{name} is another than that of {palm}: the pads must be of one kind")
        return pad


class ThreePalmsLimitsConfig(Strict):
    """What the palms may do."""

    beta_deg: AngleRange = (30.0, 73.0)
    """Tilt of palm 1 from the horizontal."""
    gamma2_deg: AngleRange = (25.0, 67.0)
    """Palm 2 about its axis."""
    gamma3_deg: AngleRange = (25.0, 67.0)
    """Palm 3 about it."""
    rate_deg_s: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(1, 360)] = 90.0
    """Of each joint."""
    acceleration_deg_s2: Annotated[FiniteFloat, Field(gt=0, le=20000), Plausible(10, 5000)] = 400.0
    """Of each joint."""
    stop_deceleration_deg_s2: Annotated[FiniteFloat, Field(gt=0, le=20000), Plausible(10, 5000)] | None = 400.0
    """Of each joint when the motion is held: harder, and the body leaves the palms."""
    following_error: JointFollowingError = JointFollowingError()
    """How far the joints may be from their delayed set-points; beyond it the arm is stopped."""
    force_n: ForceLimits | None = None
    """What may press on each pad before the motion is held; left out: nine tenths of the pad's full scale."""

    @field_validator("force_n")
    @classmethod
    def _own_pads(cls, force_n: float | PadForces | None) -> float | PadForces | None:
        return known_pads(force_n, (f"palm{palm}" for palm in PALMS))

    @property
    def ranges_deg(self) -> tuple[tuple[float, float], ...]:
        """Of each joint."""
        return (self.beta_deg, self.gamma2_deg, self.gamma3_deg)


class ThreePalmsConfig(AnyConfig):
    """The whole of a `palmd.yaml` with `rig: {system: three_palms}`."""

    system: ClassVar[str] = SYSTEM

    rig: ThreePalmsRigConfig
    """The mechanism."""
    pads: ThreePadsConfig
    """The touchpads."""
    arm: AdeptConfig
    """The controller of the joints: its line's x and y are beta and gamma2 in 1/1000 degree, its t is gamma3."""
    limits: ThreePalmsLimitsConfig = ThreePalmsLimitsConfig()
    """What the palms may do."""

    @field_validator("arm")
    @classmethod
    def _without_base(cls, arm: AdeptConfig) -> AdeptConfig:
        plain = AdeptConfig(port=arm.port)
        names = sorted(name for name in AdeptConfig.model_fields if name.startswith("base_"))
        if based := [name for name in names if getattr(arm, name) != getattr(plain, name)]:
            raise ValueError(f"{', '.join(based)}: an arm whose axes are the joints stands nowhere; leave it out")
        return arm


def three_palms_rig(config: ThreePalmsConfig) -> ThreePalmsRig:
    """What an observer must know of the configured rig (SI)."""
    pad = config.pads.palm1
    return ThreePalmsRig(
        gravity=config.rig.gravity_m_s2,
        pad=PadPlane(side=pad.length_mm * 1e-3, noise=pad.noise_mm * 1e-3, resolution=1e-3 / pad.counts_per_mm),
        angle_noise=math.radians(config.rig.angle_noise_deg),
        vibration=vibration_of(config.rig.vibration),
    )


# ------------------------------------------------------------------------------------------------------ plans


class TiltAngles(JointValues):
    """Where the joints shall go; what is left out stays."""

    beta_deg: FiniteFloat | None = None
    """Tilt of palm 1."""
    gamma2_deg: FiniteFloat | None = None
    """Palm 2 about its axis."""
    gamma3_deg: FiniteFloat | None = None
    """Palm 3 about it."""


class TiltMoveSpec(Strict):
    """From rest to rest on a minimum-jerk path."""

    move: TiltAngles
    """Where to."""
    duration_s: Duration
    """How long it takes."""


class TiltHoldSpec(Strict):
    """Stand still."""

    hold_s: Duration
    """For how long."""


def _for_all_joints(value: Any) -> Any:
    return value if isinstance(value, list) else [value] * 3


class TiltSineSpec(Strict):
    """Swing about the pose where it starts, growing in and dying away."""

    sine: TiltAngles
    """How far to either side; left out: not at all."""
    frequency_hz: Annotated[list[SwingFrequency], Field(min_length=3, max_length=3)] | SwingFrequency
    """Of all joints, or one for each."""
    duration_s: Duration
    """How long it takes, growing in and dying away included."""

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Of each joint."""
        return tuple(_for_all_joints(self.frequency_hz))


class TiltGoal(ExploreGoal):
    """When an exploration has seen enough: shares are of all directions."""

    @field_validator("band_mm")
    @classmethod
    def _without_band(cls, band_mm: float | None) -> float | None:
        if band_mm is not None:
            raise ValueError("three palms do not explore until a band is reached: leave it out")
        return band_mm


class TiltExploreSpec(ExploreSpec):
    """Closed-loop motion that turns the body on to what has not been touched yet; swings until it is known."""

    explore: TiltGoal
    """When it has seen enough; must be the last segment."""


TiltSegmentSpec = Annotated[
    Annotated[TiltMoveSpec, Tag("<move>")]
    | Annotated[TiltHoldSpec, Tag("<hold_s>")]
    | Annotated[TiltSineSpec, Tag("<sine>")]
    | Annotated[TiltExploreSpec, Tag("<explore>")],
    one_key_of(("move", "hold_s", "sine", "explore")),
]


class TiltPlanSpec(AnyPlanSpec):
    """A motion plan of three palms as it stands in its file."""

    segments: Annotated[list[TiltSegmentSpec], Field(min_length=1, max_length=200)]
    """Motions, one after the other."""
