"""The configuration of two palms, `palmd.yaml`, their motion plans, and what an observer must know of such a rig."""

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
from palmd.config.guards import ForceLimits, PadForces, PalmFollowingError, known_pads
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
from palmd.config.tabletop import TABLETOP
from palmd.config.vibration import VibrationConfig, vibration_of
from palmd.events import ObserverName
from palmd.system.description import RigDescription
from palmd.system.mechanism import JOINTS, PALMS
from palmd.systems import TWO_PALMS


class PadImperfectionsConfig(Strict):
    """By how much the emulated pad of one palm is off from what it is taken for."""

    zero_mm: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """What it reads more, everywhere."""
    scale: Annotated[FiniteFloat, Field(ge=-0.2, le=0.2)] = 0.0
    """What it reads more, as a share of the distance from the hinge."""
    standoff_mm: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """How far its surface lies above the hinge line, on the object's side."""
    sagitta_mm: Annotated[FiniteFloat, Field(ge=-5, le=5)] = 0.0
    """By how much its middle is higher than its ends."""
    lag_ms: Annotated[FiniteFloat, Field(ge=-10, le=100)] = 0.0
    """How late its readings are."""
    force_mm_per_n: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """What it reads more under each newton."""


class ImperfectionsConfig(Strict):
    """Of the emulated rig: by how much its constants are off from what they are taken for."""

    palm1: PadImperfectionsConfig = PadImperfectionsConfig()
    """The pad of palm 1."""
    palm2: PadImperfectionsConfig = PadImperfectionsConfig()
    """The pad of palm 2."""
    phi1_deg: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """True palm 1 above what the arm's pose tells."""
    phi2_deg: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """The same of the angle between the palms."""
    gravity_deg: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """By how much the table tips: palm 1 is that much steeper against gravity."""
    friction_asymmetry: Annotated[FiniteFloat, Field(gt=-1, lt=1)] = 0.0
    """(μ1 − μ2)/(μ1 + μ2) of the palms' friction."""
    vibration_m_s2: Annotated[FiniteFloat, Field(ge=0, le=5)] = 0.0
    """RMS acceleration with which the table shakes up and down."""


Drawn = Literal["none", "calibrated"]
"""Imperfections of the emulated rig that need not be written out: none at all, or drawn from how well it is known."""


def _imperfections_kind(value: Any) -> str:
    return "<values>" if isinstance(value, dict | ImperfectionsConfig) else "<word>"


class RigConfig(Strict):
    """Gravity and the palms' linkage, in the world frame."""

    gravity_m_s2: Annotated[FiniteFloat, Field(gt=0, le=30), Plausible(0.1, 12)] = 9.81
    """In the plane of the palms: 9.81 · sin(tilt of the table)."""
    hinge: Literal["arc", "fixed"] = "arc"
    """`arc`: palm 1 is hinged to B, an arm holds the far end of palm 2; `fixed`: both turn about one axis."""
    base_mm: Annotated[Pair, Plausible(5, 2000, or_zero=True)] = (120.0, 0.0)
    """B, the fixed hinge at the far end of palm 1, in the world frame; of an arc hinge only."""
    palm1_length_mm: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(20, 1000)] = 120.0
    """From the hinge between the palms to B; with `hinge: fixed` to palm 1's end, by default 75."""
    palm2_length_mm: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(20, 1000)] = 120.0
    """From the hinge between the palms to where the arm holds palm 2; with `hinge: fixed` to its end, by default 75."""
    palm1_curvature_per_m: Annotated[FiniteFloat, Field(ge=-100, le=100), Plausible(1, 20, or_zero=True)] = 0.0
    """Of the arc that palm 1 is, from the hinge on: 1/radius, > 0 a concave cradle, < 0 a dome, 0 flat."""
    palm2_curvature_per_m: Annotated[FiniteFloat, Field(ge=-100, le=100), Plausible(1, 20, or_zero=True)] = 0.0
    """Of the arc that palm 2 is."""
    angle_sd_deg: Annotated[NotNegative, Field(le=10), Plausible(0.001, 3, or_zero=True)] = 0.1
    """How well the palms' angles are known, one sigma; this and the other `_sd` are as calibration leaves a rig."""
    gravity_sd_deg: Annotated[NotNegative, Field(le=10), Plausible(0.001, 5, or_zero=True)] = 0.2
    """How well gravity's direction is known, one sigma."""
    friction_asymmetry_sd: Annotated[NotNegative, Field(le=1)] = 0.3
    """How alike the palms rub: one sigma of (μ1 − μ2)/(μ1 + μ2); 0 where both surely have one friction."""
    vibration: VibrationConfig = VibrationConfig()
    """Of the palms along themselves, which breaks friction; left out: independent, and nothing else is known."""
    imperfections: Annotated[
        Annotated[Drawn, Tag("<word>")] | Annotated[ImperfectionsConfig, Tag("<values>")],
        Discriminator(_imperfections_kind),
    ] = Field(default="none", exclude=True)  # excluded: the daemon's rig is the same whatever the emulated one is
    """Of the emulated rig alone: `none`, drawn from all the `_sd` (`calibrated`), or a block of what is off."""

    @model_validator(mode="before")
    @classmethod
    def _as_drawn(cls, values: Any) -> Any:
        """A fixed hinge is by default that of the tabletop rig."""
        if not (isinstance(values, dict) and values.get("hinge") == "fixed"):
            return values
        return {f"palm{palm}_length_mm": TABLETOP.palm_length for palm in PALMS} | values

    @property
    def palm_lengths_mm(self) -> tuple[float, ...]:
        """Of each palm."""
        return tuple(getattr(self, f"palm{palm}_length_mm") for palm in PALMS)

    @property
    def curvatures_per_m(self) -> tuple[float, ...]:
        """Of each palm."""
        return tuple(getattr(self, f"palm{palm}_curvature_per_m") for palm in PALMS)


class PadsConfig(AnyPads):
    """Both touchpads."""

    palm1: PadConfig
    """The pad of palm 1."""
    palm2: PadConfig
    """The pad of palm 2; not on the same port."""

    def of(self, palm: int) -> PadConfig:
        """The pad of the palm of that number."""
        pad: PadConfig = getattr(self, f"palm{palm}")
        return pad


class LimitsConfig(Strict):
    """What the palms may do; the same rate and acceleration hold for each palm angle."""

    phi1_deg: Annotated[TiltRange, Plausible(10, 180)] = (6.0, 150.0)
    """Palm 1 from the world X axis; below 0 where it is a cradle, whose tangent points up where it is touched."""
    phi2_deg: Annotated[OpeningRange, Plausible(10, 180)] = (35.0, 155.0)
    """Palm 2 from palm 1."""
    rate_deg_s: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(3, 720)] = 120.0
    """Of each palm angle."""
    acceleration_deg_s2: Annotated[FiniteFloat, Field(gt=0, le=50000), Plausible(20, 20000)] = 900.0
    """Of each palm angle."""
    stop_deceleration_deg_s2: Annotated[FiniteFloat, Field(gt=0, le=50000), Plausible(100, 20000)] | None = None
    """Of each palm angle when the motion is held, never more than the arm itself allows; left out: as much as that."""
    following_error: PalmFollowingError = PalmFollowingError()
    """How far the arm may be from its delayed set-point; beyond it the arm is stopped."""
    force_n: ForceLimits | None = None
    """What may press on each pad before the motion is held; left out: nine tenths of the pad's full scale."""

    @field_validator("force_n")
    @classmethod
    def _own_pads(cls, force_n: float | PadForces | None) -> float | PadForces | None:
        return known_pads(force_n, (f"palm{palm}" for palm in PALMS))

    @property
    def angles_deg(self) -> tuple[tuple[float, float], ...]:
        """Of each joint."""
        return tuple(getattr(self, f"{joint}_deg") for joint in JOINTS)


class ObserverConfig(Strict):
    """Which observer gives the published estimate."""

    primary: ObserverName = "shape"
    """Whose estimate is published."""
    smoother: bool = True
    """Beside the loop, in a process of its own; for the shape map of an unknown outline only."""
    shape: FilePath | None = None
    """A stored outline, or a folder of them: the object is one of these, or none."""

    @field_validator("shape")
    @classmethod
    def _usable(cls, path: Path | None, info: ValidationInfo) -> Path | None:
        if path is not None and not exists(path):
            raise ValueError(f"{path} does not exist; name an outline file or a folder of them")
        if path is not None and info.data.get("primary", "shape") != "shape":
            raise ValueError(f"needs primary: shape; the observer {info.data['primary']} cannot use a stored outline")
        return path


class Config(AnyConfig):
    """The whole of a `palmd.yaml` of two palms."""

    system: ClassVar[str] = TWO_PALMS

    rig: RigConfig = RigConfig()
    """Geometry and gravity."""
    pads: PadsConfig
    """The touchpads."""
    arm: ArmConfig
    """The robot arm."""
    limits: LimitsConfig = LimitsConfig()
    """What the palms may do."""
    observer: ObserverConfig = ObserverConfig()
    """Who estimates."""

    @field_validator("pads")
    @classmethod
    def _on_arcs(cls, pads: PadsConfig, info: ValidationInfo) -> PadsConfig:
        rig: RigConfig | None = info.data.get("rig")
        for palm, (kappa, pad) in enumerate(zip(rig.curvatures_per_m if rig else (), pads.each(), strict=False), 1):
            if abs(kappa) * pad.length_mm * 1e-3 > math.pi / 2:
                raise ValueError(f"rig.palm{palm}_curvature_per_m bends the pad by more than a quarter turn")
        return pads

    @field_validator("limits")
    @classmethod
    def _points_up(cls, limits: LimitsConfig, info: ValidationInfo) -> LimitsConfig:
        rig: RigConfig | None = info.data.get("rig")
        if limits.phi1_deg[0] < 0.0 and rig is not None and rig.palm1_curvature_per_m <= 0.0:
            raise ValueError("phi1_deg must not begin below 0: only a cradle may point downwards at its hinge")
        return limits

    @field_validator("observer")
    @classmethod
    def _knows_arcs(cls, observer: ObserverConfig, info: ValidationInfo) -> ObserverConfig:
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
            raise ValueError(f"kind {arm.kind} drives hinge: {arm.hinge}, but rig.hinge is {rig.hinge}")
        return arm

    @property
    def outlines(self) -> Path | None:
        """As configured."""
        return self.observer.shape

    @property
    def explores(self) -> bool:
        """The `shape` observer does."""
        return self.observer.primary == "shape"


def rig_description(config: Config) -> RigDescription:
    """What an observer must know of the configured rig (SI)."""
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
    """Where palm angles shall go; an angle that is left out stays."""

    phi1_deg: FiniteFloat | None = None
    """Palm 1 from the world X axis."""
    phi2_deg: FiniteFloat | None = None
    """Palm 2 from palm 1."""

    @field_validator("*", mode="before")
    @classmethod
    def _written(cls, value: Any) -> Any:
        if value is None:
            raise ValueError("has no value: write one or leave the key out")
        return value


class PalmRates(JointValues):
    """Constant rates of the palm angles; zero where left out."""

    phi1_deg_s: FiniteFloat = 0.0
    """Of φ1."""
    phi2_deg_s: FiniteFloat = 0.0
    """Of φ2."""


class PalmAmplitudes(JointValues):
    """Amplitudes about the pose where a sine starts; zero where left out, negative for opposite phase."""

    phi1_deg: Annotated[FiniteFloat, Field(ge=-90, le=90)] = 0.0
    """Of φ1."""
    phi2_deg: Annotated[FiniteFloat, Field(ge=-90, le=90)] = 0.0
    """Of φ2."""


class MoveSpec(Strict):
    """From rest to rest on a minimum-jerk path."""

    move: PalmAngles
    """Where to; an angle that is left out stays."""
    duration_s: Duration
    """How long it takes."""

    @field_validator("move")
    @classmethod
    def _goes_somewhere(cls, move: PalmAngles) -> PalmAngles:
        if all(angle is None for angle in move.each()):
            raise ValueError("needs phi1_deg, phi2_deg or both")
        return move


class RateSpec(Strict):
    """Constant rates until one palm angle is reached, where the palms come to rest."""

    rate: PalmRates
    """How fast."""
    until: PalmAngles
    """The one angle that ends it."""

    @field_validator("rate")
    @classmethod
    def _turns(cls, rate: PalmRates) -> PalmRates:
        if not any(rate.each()):
            raise ValueError("needs a rate other than 0 for phi1_deg_s or phi2_deg_s")
        return rate

    @field_validator("until")
    @classmethod
    def _one_end(cls, until: PalmAngles) -> PalmAngles:
        if sum(angle is not None for angle in until.each()) != 1:
            raise ValueError("needs exactly one of phi1_deg, phi2_deg")
        return until


class SineSpec(Strict):
    """Swing about the pose where it starts, growing in and dying away."""

    sine: PalmAmplitudes
    """How far to either side."""
    frequency_hz: SwingFrequencies
    """Of both palms, or one for each."""
    duration_s: Duration
    """How long it takes, growing in and dying away included."""


SegmentSpec = Annotated[
    Annotated[MoveSpec, Tag("<move>")]
    | Annotated[RateSpec, Tag("<rate>")]
    | Annotated[HoldSpec, Tag("<hold_s>")]
    | Annotated[SineSpec, Tag("<sine>")]
    | Annotated[ExploreSpec, Tag("<explore>")],
    one_key_of(SEGMENT_KINDS),
]


class DitherSpec(Strict):
    """A small vibration of both palm angles on top of the whole plan, to break friction."""

    amplitude_deg: Annotated[FiniteFloat, Field(gt=0, le=5)]
    """Of both angles."""
    frequency_hz: Annotated[FiniteFloat, Field(gt=0, le=20)]
    """Of both angles."""


class PlanSpec(AnyPlanSpec):
    """A motion plan as it stands in its file; `palmd.motion.plan` makes a trajectory of it."""

    repeat: Repeat = 1
    """How often the segments are run."""
    segments: Annotated[list[SegmentSpec], Field(min_length=1, max_length=200)]
    """Motions, one after the other."""
    dither: DitherSpec | None = None
    """A small vibration on top of it all, to break friction."""
