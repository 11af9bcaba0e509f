"""Configuration (`palmd.yaml`) and motion plans of two palms, and the conversion to the observers' description."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    FiniteFloat,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from palmd.config.any_config import AnyConfig
from palmd.config.arms import ArmConfig
from palmd.config.fields import FilePath, NotNegative, OpeningRange, Pair, Plausible, Strict, TiltRange, exists
from palmd.config.guards import ForceLimits, PalmFollowingError, only_palms
from palmd.config.pads import AnyPads, PadConfig, pad_sensor
from palmd.config.plans import (
    AnyPlanSpec,
    Duration,
    ExploreSpec,
    HoldSpec,
    JointValues,
    Repeat,
    SwingFrequency,
    one_key_of,
)
from palmd.config.tabletop import PALM_LENGTH_MM
from palmd.config.vibration import VibrationConfig, vibration_of
from palmd.events import ObserverName
from palmd.system.description import RigDescription
from palmd.system.mechanism import JOINTS, PALMS
from palmd.systems import TWO_PALMS


class PadImperfectionsConfig(Strict):
    """Deviations of an emulated pad from its configuration."""

    zero_mm: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """Offset added to all readings."""
    scale: Annotated[FiniteFloat, Field(ge=-0.2, le=0.2)] = 0.0
    """Error of the reading as a share of the distance from the hinge."""
    standoff_mm: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """Height of its surface above the hinge line, on the object's side."""
    sagitta_mm: Annotated[FiniteFloat, Field(ge=-5, le=5)] = 0.0
    """Height of its middle over its ends."""
    lag_ms: Annotated[FiniteFloat, Field(ge=-10, le=100)] = 0.0
    """Delay of its readings."""
    force_mm_per_n: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """Shift of its readings per newton."""


class ImperfectionsConfig(Strict):
    """Deviations of the emulated rig's constants from the configuration."""

    palm1: PadImperfectionsConfig = PadImperfectionsConfig()
    """The pad of palm 1."""
    palm2: PadImperfectionsConfig = PadImperfectionsConfig()
    """The pad of palm 2."""
    phi1_deg: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """True angle of palm 1 minus the one computed from the arm's pose."""
    phi2_deg: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """The same for the angle between the palms."""
    gravity_deg: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """Tilt of the table: palm 1 is steeper against gravity by this angle."""
    friction_asymmetry: Annotated[FiniteFloat, Field(gt=-1, lt=1)] = 0.0
    """(μ1 − μ2)/(μ1 + μ2) of the palms' friction."""
    vibration_m_s2: Annotated[FiniteFloat, Field(ge=0, le=5)] = 0.0
    """RMS vertical acceleration of the shaking table."""


DrawnImperfections = Literal["none", "calibrated"]
"""Imperfections of the emulated rig without values: none, or drawn from the configured standard deviations."""


def _imperfections_kind(value: Any) -> str:
    return "<values>" if isinstance(value, dict | ImperfectionsConfig) else "<word>"


class RigConfig(Strict):
    """Gravity and the palms' linkage, in the world frame."""

    gravity_m_s2: Annotated[FiniteFloat, Field(gt=0, le=30), Plausible(0.1, 12)] = 9.81
    """Component in the plane of the palms: 9.81 · sin(tilt of the table)."""
    hinge: Literal["arc", "fixed"] = "arc"
    """`arc`: palm 1 is hinged at B, an arm holds the far end of palm 2; `fixed`: both palms turn about one axis."""
    base_mm: Annotated[Pair, Plausible(5, 2000, or_zero=True)] = (120.0, 0.0)
    """B, the fixed hinge at the far end of palm 1, in the world frame; with `hinge: arc` only."""
    palm1_length_mm: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(20, 1000)] = 120.0
    """From the hinge between the palms to B; with `hinge: fixed` to palm 1's end, by default 75."""
    palm2_length_mm: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(20, 1000)] = 120.0
    """From the hinge between the palms to where the arm holds palm 2; with `hinge: fixed` to its end, by default 75."""
    palm1_curvature_per_m: Annotated[FiniteFloat, Field(ge=-100, le=100), Plausible(1, 20, or_zero=True)] = 0.0
    """Curvature of palm 1 from the hinge on: 1/radius, > 0 a concave cradle, < 0 a dome, 0 flat."""
    palm2_curvature_per_m: Annotated[FiniteFloat, Field(ge=-100, le=100), Plausible(1, 20, or_zero=True)] = 0.0
    """Curvature of palm 2."""
    angle_sd_deg: Annotated[NotNegative, Field(le=10), Plausible(0.001, 3, or_zero=True)] = 0.1
    """Standard deviation of the palms' angles; the defaults of all `_sd` are those of a calibrated rig."""
    gravity_sd_deg: Annotated[NotNegative, Field(le=10), Plausible(0.001, 5, or_zero=True)] = 0.2
    """Standard deviation of gravity's direction."""
    friction_asymmetry_sd: Annotated[NotNegative, Field(le=1)] = 0.3
    """Standard deviation of (μ1 − μ2)/(μ1 + μ2), the friction asymmetry; 0: both palms have the same friction."""
    vibration: VibrationConfig = VibrationConfig()
    """Vibration of the palms along themselves, which breaks friction; if omitted: independent, otherwise unknown."""
    imperfections: Annotated[
        Annotated[DrawnImperfections, Tag("<word>")] | Annotated[ImperfectionsConfig, Tag("<values>")],
        Discriminator(_imperfections_kind),
    ] = Field(default="none", exclude=True)  # excluded from hashes: they do not concern the daemon
    """For the emulated rig only: `none`, drawn from all `_sd` (`calibrated`), or a block of deviations."""

    @model_validator(mode="before")
    @classmethod
    def _tabletop_defaults(cls, values: Any) -> Any:
        """Use the tabletop rig's palm lengths as defaults for a fixed hinge."""
        if not (isinstance(values, dict) and values.get("hinge") == "fixed"):
            return values
        return {f"palm{palm}_length_mm": PALM_LENGTH_MM for palm in PALMS} | values

    @property
    def palm_lengths_mm(self) -> tuple[float, ...]:
        """Length of each palm."""
        return tuple(getattr(self, f"palm{palm}_length_mm") for palm in PALMS)

    @property
    def curvatures_per_m(self) -> tuple[float, ...]:
        """Curvature of each palm."""
        return tuple(getattr(self, f"palm{palm}_curvature_per_m") for palm in PALMS)


class PadsConfig(AnyPads):
    """Both touch pads."""

    palm1: PadConfig
    """The pad of palm 1."""
    palm2: PadConfig
    """The pad of palm 2, on another port."""

    def of(self, palm: int) -> PadConfig:
        """Return the pad of palm number `palm`."""
        pad: PadConfig = getattr(self, f"palm{palm}")
        return pad


class LimitsConfig(Strict):
    """Limits of the palms' motion; rate and acceleration are the same for both palm angles."""

    phi1_deg: Annotated[TiltRange, Plausible(10, 180)] = (6.0, 150.0)
    """Range of palm 1's angle from the world X axis; below 0 only for a cradle, whose tangent rises outwards."""
    phi2_deg: Annotated[OpeningRange, Plausible(10, 180)] = (35.0, 155.0)
    """Range of the angle from palm 1 to palm 2."""
    rate_deg_s: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(3, 720)] = 120.0
    """Maximum rate of each palm angle."""
    acceleration_deg_s2: Annotated[FiniteFloat, Field(gt=0, le=50000), Plausible(20, 20000)] = 900.0
    """Maximum acceleration of each palm angle."""
    stop_deceleration_deg_s2: Annotated[FiniteFloat, Field(gt=0, le=50000), Plausible(100, 20000)] | None = None
    """Deceleration of each palm angle when the motion is held, at most the arm's own limit, which is the default."""
    following_error: PalmFollowingError = PalmFollowingError()
    """Largest distance of the arm from its delayed set-point; beyond it the arm is stopped."""
    force_n: ForceLimits | None = None
    """Force on each pad at which the motion is held; default 0.9 of the pad's full scale."""

    _own_pads = field_validator("force_n")(only_palms(PALMS))

    @property
    def angles_deg(self) -> tuple[tuple[float, float], ...]:
        """Range of each joint."""
        return tuple(getattr(self, f"{joint}_deg") for joint in JOINTS)


class ObserverConfig(Strict):
    """The observers."""

    primary: ObserverName = "shape"
    """Observer whose estimate is published."""
    smoother: bool = True
    """Whether the fixed-lag smoother runs, in a separate process; only for `shape` without stored outlines."""
    shape: FilePath | None = None
    """A stored outline, or a folder of them, for recognition; the object may also be none of them."""

    @field_validator("shape")
    @classmethod
    def _usable(cls, path: Path | None, info: ValidationInfo) -> Path | None:
        if path is not None and not exists(path):
            raise ValueError(f"{path} does not exist; name an outline file or a folder of them")
        if path is not None and info.data.get("primary", "shape") != "shape":
            raise ValueError(f"needs primary: shape; the observer {info.data['primary']} cannot use a stored outline")
        return path


class Config(AnyConfig):
    """A complete `palmd.yaml` of two palms."""

    system: ClassVar[str] = TWO_PALMS

    rig: RigConfig = RigConfig()
    """Geometry and gravity."""
    pads: PadsConfig
    """The touch pads."""
    arm: ArmConfig
    """The robot arm."""
    limits: LimitsConfig = LimitsConfig()
    """Limits of the palms' motion."""
    observer: ObserverConfig = ObserverConfig()
    """The observers."""

    @field_validator("pads")
    @classmethod
    def _limited_arc(cls, pads: PadsConfig, info: ValidationInfo) -> PadsConfig:
        rig: RigConfig | None = info.data.get("rig")
        for palm, (kappa, pad) in enumerate(zip(rig.curvatures_per_m if rig else (), pads.each(), strict=False), 1):
            if abs(kappa) * pad.length_mm * 1e-3 > math.pi / 2:
                raise ValueError(f"rig.palm{palm}_curvature_per_m bends the pad by more than a quarter turn")
        return pads

    @field_validator("limits")
    @classmethod
    def _not_below_zero(cls, limits: LimitsConfig, info: ValidationInfo) -> LimitsConfig:
        rig: RigConfig | None = info.data.get("rig")
        if limits.phi1_deg[0] < 0.0 and rig is not None and rig.palm1_curvature_per_m <= 0.0:
            raise ValueError("phi1_deg must not begin below 0: only a cradle may point downwards at its hinge")
        return limits

    @field_validator("observer")
    @classmethod
    def _supports_arcs(cls, observer: ObserverConfig, info: ValidationInfo) -> ObserverConfig:
        rig: RigConfig | None = info.data.get("rig")
        if rig is None or not any(rig.curvatures_per_m):
            return observer
        if observer.primary != "shape":
            raise ValueError(f"{observer.primary} knows flat palms only; these are curved: set primary to shape")
        return observer

    @field_validator("arm")
    @classmethod
    def _own_hinge(cls, arm: ArmConfig, info: ValidationInfo) -> ArmConfig:
        rig: RigConfig | None = info.data.get("rig")
        if rig is not None and rig.hinge != arm.hinge:
            raise ValueError(f"kind {arm.kind} needs hinge: {arm.hinge}, but rig.hinge is {rig.hinge}")
        return arm

    @property
    def outlines(self) -> Path | None:
        """`observer.shape`."""
        return self.observer.shape

    @property
    def explores(self) -> bool:
        """True for the `shape` observer."""
        return self.observer.primary == "shape"


def rig_description(config: Config) -> RigDescription:
    """Convert the configuration to the observers' description (SI)."""
    return RigDescription(
        gravity=config.rig.gravity_m_s2,
        hinge=config.rig.hinge,
        palm1_length=config.rig.palm1_length_mm * 1e-3,
        base=(config.rig.base_mm[0] * 1e-3, config.rig.base_mm[1] * 1e-3),
        palm_angle_noise=config.arm.angle_noise_rad,
        goal_rounding=config.arm.goal_rounding_rad,
        angle_sd=math.radians(math.hypot(config.rig.angle_sd_deg, config.arm.play_sd_deg)),
        gravity_sd=math.radians(config.rig.gravity_sd_deg),
        friction_sd=config.rig.friction_asymmetry_sd,
        pads=tuple(
            pad_sensor(pad, kappa) for pad, kappa in zip(config.pads.each(), config.rig.curvatures_per_m, strict=True)
        ),
        vibration=vibration_of(config.rig.vibration),
    )


def _for_both_palms(value: Any) -> Any:
    return value if isinstance(value, list) else [value, value]


SEGMENT_KINDS = ("move", "rate", "hold_s", "sine", "explore")
SwingFrequencies = Annotated[
    tuple[SwingFrequency, SwingFrequency], Field(strict=False), BeforeValidator(_for_both_palms)
]


class PalmAngles(JointValues):
    """Target of the palm angles; an omitted angle stays unchanged."""

    phi1_deg: FiniteFloat | None = None
    """Palm 1 from the world X axis."""
    phi2_deg: FiniteFloat | None = None
    """Palm 2 from palm 1."""

    @field_validator("*", mode="before")
    @classmethod
    def _has_value(cls, value: Any) -> Any:
        if value is None:
            raise ValueError("has no value: write one or leave the key out")
        return value


class PalmRates(JointValues):
    """Constant rates of the palm angles; 0 if omitted."""

    phi1_deg_s: FiniteFloat = 0.0
    """Rate of φ1."""
    phi2_deg_s: FiniteFloat = 0.0
    """Rate of φ2."""


class PalmAmplitudes(JointValues):
    """Amplitudes of a sine about its start pose; 0 if omitted, negative for opposite phase."""

    phi1_deg: Annotated[FiniteFloat, Field(ge=-90, le=90)] = 0.0
    """Amplitude of φ1."""
    phi2_deg: Annotated[FiniteFloat, Field(ge=-90, le=90)] = 0.0
    """Amplitude of φ2."""


class MoveSpec(Strict):
    """From rest to rest on a minimum-jerk path."""

    move: PalmAngles
    """Target; an omitted angle stays unchanged."""
    duration_s: Duration
    """Duration."""

    @field_validator("move")
    @classmethod
    def _has_target(cls, move: PalmAngles) -> PalmAngles:
        if all(angle is None for angle in move.each()):
            raise ValueError("needs phi1_deg, phi2_deg or both")
        return move


class RateSpec(Strict):
    """Constant rates until one palm angle is reached, then deceleration to rest."""

    rate: PalmRates
    """The rates."""
    until: PalmAngles
    """The angle that ends it; exactly one."""

    @field_validator("rate")
    @classmethod
    def _has_rate(cls, rate: PalmRates) -> PalmRates:
        if not any(rate.each()):
            raise ValueError("needs a rate other than 0 for phi1_deg_s or phi2_deg_s")
        return rate

    @field_validator("until")
    @classmethod
    def _single_end(cls, until: PalmAngles) -> PalmAngles:
        if sum(angle is not None for angle in until.each()) != 1:
            raise ValueError("needs exactly one of phi1_deg, phi2_deg")
        return until


class SineSpec(Strict):
    """Swing about the start pose, with a smooth onset and decay."""

    sine: PalmAmplitudes
    """Amplitudes."""
    frequency_hz: SwingFrequencies
    """Frequency of both palms, or one for each."""
    duration_s: Duration
    """Duration, including onset and decay."""


SegmentSpec = Annotated[
    Annotated[MoveSpec, Tag("<move>")]
    | Annotated[RateSpec, Tag("<rate>")]
    | Annotated[HoldSpec, Tag("<hold_s>")]
    | Annotated[SineSpec, Tag("<sine>")]
    | Annotated[ExploreSpec, Tag("<explore>")],
    one_key_of(SEGMENT_KINDS),
]


class DitherSpec(Strict):
    """A small oscillation of both palm angles, added to the whole plan to break friction."""

    amplitude_deg: Annotated[FiniteFloat, Field(gt=0, le=5)]
    """Amplitude of both angles."""
    frequency_hz: Annotated[FiniteFloat, Field(gt=0, le=20)]
    """Frequency of both angles."""


class PlanSpec(AnyPlanSpec):
    """Model of a plan file; `palmd.motion.plan` compiles it to a trajectory."""

    repeat: Repeat = 1
    """How many times the segments are executed."""
    segments: Annotated[list[SegmentSpec], Field(min_length=1, max_length=200)]
    """Motions in the order of execution."""
    dither: DitherSpec | None = None
    """A small oscillation added to all motions, to break friction."""
