"""Configuration and plans of a rig with a pivoting gripper: one pad, and an arm that moves the pivot above it."""

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
from palmd.config.two_palms import DrawnImperfections
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
    """Kind of rig."""
    gravity_m_s2: Annotated[FiniteFloat, Field(gt=0, le=30), Plausible(0.1, 12)] = 9.81
    """Component in the plane of motion, towards the pad."""
    vertical: Literal["rigid", "float"] = "rigid"
    """`rigid`: the arm holds the pivot's height; `float`: a carriage slides on the arm by its own weight."""
    carriage_mass_kg: Annotated[
        Annotated[Positive, Field(le=5), Plausible(0.005, 0.5)] | None, Field(validate_default=True)
    ] = None
    """Mass of the sliding part without the body; with `vertical: float` only."""
    damping_n_s_m: Annotated[NotNegative, Field(le=100), Plausible(0.001, 5, or_zero=True)] = 0.0
    """Damping of the slide, force per speed."""
    z_measured: bool = True
    """Whether the arm reports the pivot's height, including a slide's travel; must be true for live estimation."""
    arm_noise_mm: Annotated[Positive, Field(le=1), Plausible(0.001, 0.2)] = 0.02
    """Standard deviation of the noise of the pivot's reported position, along and above the pad."""
    angle_sd_deg: Annotated[NotNegative, Field(le=10), Plausible(0.001, 3, or_zero=True)] = 0.1
    """Standard deviation of the pad's slope along the arm's x."""
    vibration: VibrationConfig = VibrationConfig()
    """Vibration of the pad along itself, which breaks friction; `relation` only states whether it vibrates."""
    imperfections: Annotated[DrawnImperfections, Field(exclude=True)] = "none"
    """For the emulated rig only: `none`, or drawn from all `_sd` (`calibrated`)."""

    @field_validator("carriage_mass_kg")
    @classmethod
    def _slides(cls, mass: float | None, info: ValidationInfo) -> float | None:
        slides = info.data.get("vertical") == "float"
        if slides and mass is None:
            raise ValueError("a slide needs the mass of its carriage without the body: set carriage_mass_kg")
        if mass is not None and not slides:
            raise ValueError("only a slide has a carriage: remove carriage_mass_kg, or set vertical: float")
        return mass

    @field_validator("z_measured")
    @classmethod
    def _height_is_measured(cls, measured: bool) -> bool:
        if not measured:
            raise ValueError(
                "without the pivot's height the body's mean radius is unobservable: the controller must report it"
            )
        return measured


class PivotPadsConfig(AnyPads):
    """The touch pad."""

    palm1: PadConfig
    """The pad over which the body is dragged; its zero is at the arm's x = 0."""


class PivotLimitsConfig(Strict):
    """Limits of the gripper's motion."""

    x_mm: Range = (2.0, 53.0)
    """Range of the pivot along the pad, from the pad's zero."""
    z_mm: Range = (8.0, 70.0)
    """Range of the pivot's height above the pad's surface."""
    speed_mm_s: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(1, 300)] = 40.0
    """Maximum speed along each axis."""
    acceleration_mm_s2: Annotated[FiniteFloat, Field(gt=0, le=20000), Plausible(10, 5000)] = 400.0
    """Maximum acceleration along each axis."""
    stop_deceleration_mm_s2: Annotated[FiniteFloat, Field(gt=0, le=20000), Plausible(10, 20000)] | None = 2000.0
    """Deceleration along each axis when the motion is held."""
    force_n: Annotated[Positive, Field(le=50), Plausible(0.3, 20)] = 2.0
    """Largest force on the pad, including a slide's carriage; an exploration stays well below."""
    following_error: AxisFollowingError = AxisFollowingError()
    """Largest distance of the gripper from its delayed set-point; beyond it the arm is stopped."""

    @property
    def ranges_mm(self) -> tuple[tuple[float, float], ...]:
        """Range of each axis."""
        return (self.x_mm, self.z_mm)


class PivotConfig(AnyConfig):
    """A complete `palmd.yaml` with `rig: {system: pivot}`."""

    system: ClassVar[str] = SYSTEM

    rig: PivotRigConfig
    """The gripper."""
    pads: PivotPadsConfig
    """The touchpad."""
    arm: AdeptConfig
    """The robot arm: its tool is the pivot, its x lies along the pad and its y above it."""
    limits: Annotated[PivotLimitsConfig, Field(validate_default=True)] = PivotLimitsConfig()
    """Limits of the gripper's motion."""

    @field_validator("limits")
    @classmethod
    def _measurable_force(cls, limits: PivotLimitsConfig, info: ValidationInfo) -> PivotLimitsConfig:
        pads: PivotPadsConfig | None = info.data.get("pads")
        most = None if pads is None else 100 * pads.palm1.newtons_per_count  # no pad has fewer counts
        if most is not None and limits.force_n > most:
            raise ValueError(f"force_n is {limits.force_n:g} N, but the pad may measure no more than {most:g} N")
        rig: PivotRigConfig | None = info.data.get("rig")
        weight = (rig.carriage_mass_kg or 0.0) * rig.gravity_m_s2 if rig is not None else 0.0
        if limits.force_n <= weight:
            raise ValueError(
                f"force_n is {limits.force_n:g} N, but the carriage alone weighs {weight:.2g} N: raise it above "
                "that and the body's weight"
            )
        return limits


def pivot_rig(config: PivotConfig) -> PivotRig:
    """Convert the configuration to the observers' description (SI)."""
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


class PivotTarget(Strict):
    """Target of the pivot; an omitted coordinate stays unchanged."""

    x_mm: FiniteFloat | None = None
    """Position along the pad."""
    z_mm: FiniteFloat | None = None
    """Height above the pad."""


class PivotMoveSpec(Strict):
    """From rest to rest on a minimum-jerk path."""

    move: PivotTarget
    """Target."""
    duration_s: Annotated[FiniteFloat, Field(gt=0, le=3600)]
    """Duration."""


class PivotHoldSpec(Strict):
    """Stand still."""

    hold_s: Annotated[FiniteFloat, Field(gt=0, le=3600)]
    """Duration."""


class PivotExploreSpec(ExploreSpec):
    """Drags that touch the parts of the outline not touched yet, on both sides of the dead centre."""


PivotSegmentSpec = Annotated[
    Annotated[PivotMoveSpec, Tag("<move>")]
    | Annotated[PivotHoldSpec, Tag("<hold_s>")]
    | Annotated[PivotExploreSpec, Tag("<explore>")],
    one_key_of(("move", "hold_s", "explore")),
]


class PivotPlanSpec(AnyPlanSpec):
    """Model of the plan file of a pivoting grasp."""

    segments: Annotated[list[PivotSegmentSpec], Field(min_length=1, max_length=200)]
    """Motions, one after the other."""
