"""The configuration of a rig with a pivoting gripper: one pad, an arm that moves the pivot along and over it."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, FiniteFloat, Tag, ValidationInfo, field_validator

from palmd.config.any_config import AnyConfig
from palmd.config.arms import AdeptConfig
from palmd.config.fields import NotNegative, Pair, Plausible, Positive, Strict
from palmd.config.guards import AxisFollowingError
from palmd.config.pads import AnyPads, PadConfig, pad_sensor
from palmd.config.plans import AnyPlanSpec, ExploreSpec, one_key_of
from palmd.config.two_palms import Drawn
from palmd.config.vibration import VibrationConfig, vibration_of
from palmd.system.pivot import SYSTEM, PivotRig


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise ValueError(f"must be [low, high] with low < high; got [{pair[0]:g}, {pair[1]:g}]")
    return pair


Range = Annotated[Pair, AfterValidator(_rising)]


class PivotRigConfig(Strict):
    """The gripper and gravity."""

    system: Literal["pivot"]
    """What kind of rig it is."""
    gravity_m_s2: Annotated[FiniteFloat, Field(gt=0, le=30), Plausible(0.1, 12)] = 9.81
    """In the plane of the motion, towards the pad."""
    vertical: Literal["rigid", "float"] = "rigid"
    """`rigid`: the arm holds the pivot's height; `float`: a carriage slides on the arm by its own weight."""
    carriage_mass_kg: Annotated[
        Annotated[Positive, Field(le=5), Plausible(0.005, 0.5)] | None, Field(validate_default=True)
    ] = None
    """Of what slides, without the body; of a slide only."""
    damping_n_s_m: Annotated[NotNegative, Field(le=100), Plausible(0.001, 5, or_zero=True)] = 0.0
    """Of the slide: force by speed."""
    z_measured: bool = True
    """Whether the arm's reports have the pivot's own height, a slide's travel included: live they must."""
    arm_noise_mm: Annotated[Positive, Field(le=1), Plausible(0.001, 0.2)] = 0.02
    """One sigma of the pivot's reported position by itself, along and over the pad."""
    angle_sd_deg: Annotated[NotNegative, Field(le=10), Plausible(0.001, 3, or_zero=True)] = 0.1
    """How well the pad's slope along the arm's x is known, one sigma."""
    vibration: VibrationConfig = VibrationConfig()
    """Of the pad along itself, which breaks friction; its relation says no more than whether it vibrates."""
    imperfections: Annotated[Drawn, Field(exclude=True)] = "none"
    """Of the emulated rig alone: `none`, or drawn from all the `_sd` (`calibrated`)."""

    @field_validator("carriage_mass_kg")
    @classmethod
    def _slides(cls, mass: float | None, info: ValidationInfo) -> float | None:
        slides = info.data.get("vertical") == "float"
        if slides and mass is None:
            raise ValueError("a slide must be weighed, without the body: carriage_mass_kg is missing")
        if mass is not None and not slides:
            raise ValueError("only a slide has a carriage: leave carriage_mass_kg out, or set vertical: float")
        return mass

    @field_validator("z_measured")
    @classmethod
    def _tells_its_height(cls, measured: bool) -> bool:
        if not measured:
            raise ValueError(
                "without the pivot's height the body's mean radius stays open: let the controller report it"
            )
        return measured


class PivotPadsConfig(AnyPads):
    """The one touchpad."""

    palm1: PadConfig
    """The pad that the body is dragged over; its zero is where the arm's x is 0."""


class PivotLimitsConfig(Strict):
    """What the gripper may do."""

    x_mm: Range = (2.0, 53.0)
    """The pivot along the pad, from the pad's zero."""
    z_mm: Range = (8.0, 70.0)
    """The pivot over the pad's surface."""
    speed_mm_s: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(1, 300)] = 40.0
    """Along each of them."""
    acceleration_mm_s2: Annotated[FiniteFloat, Field(gt=0, le=20000), Plausible(10, 5000)] = 400.0
    """Along each of them."""
    stop_deceleration_mm_s2: Annotated[FiniteFloat, Field(gt=0, le=20000), Plausible(10, 20000)] | None = 2000.0
    """Along each of them when the motion is held."""
    force_n: Annotated[Positive, Field(le=50), Plausible(0.3, 20)] = 2.0
    """What the body may press on the pad, a slide's carriage included; an exploration turns back well before."""
    following_error: AxisFollowingError = AxisFollowingError()
    """How far the gripper may be from its delayed set-point; beyond it the arm is stopped."""

    @property
    def ranges_mm(self) -> tuple[tuple[float, float], ...]:
        """Of each axis."""
        return (self.x_mm, self.z_mm)


class PivotConfig(AnyConfig):
    """The whole of a `palmd.yaml` with `rig: {system: pivot}`."""

    system: ClassVar[str] = SYSTEM

    rig: PivotRigConfig
    """The gripper."""
    pads: PivotPadsConfig
    """The touchpad."""
    arm: AdeptConfig
    """The robot arm: its tool is the pivot, its x along the pad and its y over it."""
    limits: Annotated[PivotLimitsConfig, Field(validate_default=True)] = PivotLimitsConfig()
    """What the gripper may do."""

    @field_validator("limits")
    @classmethod
    def _felt(cls, limits: PivotLimitsConfig, info: ValidationInfo) -> PivotLimitsConfig:
        pads: PivotPadsConfig | None = info.data.get("pads")
        most = None if pads is None else 100 * pads.palm1.newtons_per_count  # no pad counts less far
        if most is not None and limits.force_n > most:
            raise ValueError(f"force_n is {limits.force_n:g} N, but the pad may tell no more than {most:g} N apart")
        rig: PivotRigConfig | None = info.data.get("rig")
        weight = (rig.carriage_mass_kg or 0.0) * rig.gravity_m_s2 if rig is not None else 0.0
        if limits.force_n <= weight:
            raise ValueError(
                f"force_n is {limits.force_n:g} N, but the carriage alone weighs {weight:.2g} N: raise it above "
                "that and the body's weight"
            )
        return limits


def pivot_rig(config: PivotConfig) -> PivotRig:
    """What an observer must know of the configured rig (SI)."""
    return PivotRig(
        gravity=config.rig.gravity_m_s2,
        vertical=config.rig.vertical,
        carriage_mass=config.rig.carriage_mass_kg or 0.0,
        carriage_damping=config.rig.damping_n_s_m,
        arm_noise=config.rig.arm_noise_mm * 1e-3,
        angle_sd=math.radians(config.rig.angle_sd_deg),
        pad=pad_sensor(config.pads.palm1, 0.0),
        vibration=vibration_of(config.rig.vibration),
    )


# ------------------------------------------------------------------------------------------------------ plans


class PivotPlace(Strict):
    """Where the pivot shall go; what is left out stays."""

    x_mm: FiniteFloat | None = None
    """Along the pad."""
    z_mm: FiniteFloat | None = None
    """Over the pad."""


class PivotMoveSpec(Strict):
    """From rest to rest on a minimum-jerk path."""

    move: PivotPlace
    """Where to."""
    duration_s: Annotated[FiniteFloat, Field(gt=0, le=3600)]
    """How long it takes."""


class PivotHoldSpec(Strict):
    """Stand still."""

    hold_s: Annotated[FiniteFloat, Field(gt=0, le=3600)]
    """For how long."""


class PivotExploreSpec(ExploreSpec):
    """Drags that seek the parts of the outline not felt yet, on both sides of the dead centre."""


PivotSegmentSpec = Annotated[
    Annotated[PivotMoveSpec, Tag("<move>")]
    | Annotated[PivotHoldSpec, Tag("<hold_s>")]
    | Annotated[PivotExploreSpec, Tag("<explore>")],
    one_key_of(("move", "hold_s", "explore")),
]


class PivotPlanSpec(AnyPlanSpec):
    """A motion plan of a pivoting grasp as it stands in its file."""

    segments: Annotated[list[PivotSegmentSpec], Field(min_length=1, max_length=200)]
    """Motions, one after the other."""
