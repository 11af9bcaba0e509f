"""Motion plans as they stand in their files: what all systems' have, and those of two palms."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, FiniteFloat, PlainValidator, Tag, field_validator

from palmd.config.fields import Strict

SEGMENT_KINDS = ("move", "rate", "hold_s", "sine", "explore")
MAX_DURATION_S = 3600.0


def _repeat(value: object) -> int | Literal["forever"]:
    """A whole number from 1 to 10000, or forever."""
    if value == "forever":
        return "forever"
    if type(value) is int and 1 <= value <= 10_000:
        return value
    raise ValueError(f"must be a whole number from 1 to 10000, or forever; got {value!r}")


def _for_both_palms(value: Any) -> Any:
    return value if isinstance(value, list) else [value, value]


Duration = Annotated[FiniteFloat, Field(gt=0, le=MAX_DURATION_S)]
SwingFrequency = Annotated[FiniteFloat, Field(gt=0, le=5)]
SwingFrequencies = Annotated[
    tuple[SwingFrequency, SwingFrequency], Field(strict=False), BeforeValidator(_for_both_palms)
]
Repeat = Annotated[int | Literal["forever"], PlainValidator(_repeat)]


class JointValues(Strict):
    """One value for each joint."""

    def each(self) -> tuple[float | None, ...]:
        """Them, in the order of the joints."""
        return tuple(getattr(self, name) for name in type(self).model_fields)


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


class HoldSpec(Strict):
    """Stand still."""

    hold_s: Duration
    """For how long."""


class SineSpec(Strict):
    """Swing about the pose where it starts, growing in and dying away."""

    sine: PalmAmplitudes
    """How far to either side."""
    frequency_hz: SwingFrequencies
    """Of both palms, or one for each."""
    duration_s: Duration
    """How long it takes, growing in and dying away included."""


class ExploreGoal(Strict):
    """When an exploration has seen enough."""

    coverage: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.95
    """Share of the normals that can be reached."""
    band_mm: Annotated[FiniteFloat, Field(gt=0, le=10)] | None = None
    """One sigma of the outline, all over them; left out, coverage alone counts."""
    time_limit_s: Duration = 60.0
    """When to give up."""


class ExploreSpec(Strict):
    """Closed-loop motion that seeks the parts of the outline not touched yet."""

    explore: ExploreGoal
    """When it has seen enough; must be the last segment."""


def one_key_of(kinds: tuple[str, ...]) -> Discriminator:
    """Tells which of several segments is meant by the one of these keys that it has."""

    def kind(value: Any) -> str | None:
        """The union's tag; in angle brackets so that it never looks like a key of the file."""
        found = [each for each in kinds if each in value] if isinstance(value, dict) else []
        return f"<{found[0]}>" if len(found) == 1 else None

    text = f"a segment needs exactly one of the keys {', '.join(kinds)}"
    return Discriminator(kind, custom_error_type="segment_kind", custom_error_message=text)


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


class AnyPlanSpec(Strict):
    """What the motion plans of all systems have; each is a model of its own."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    """What it is called on the bus."""
    segments: Annotated[list[Any], Field(min_length=1, max_length=200)]
    """Motions, one after the other."""


class PlanSpec(AnyPlanSpec):
    """A motion plan as it stands in its file; `palmd.motion.plan` makes a trajectory of it."""

    repeat: Repeat = 1
    """How often the segments are run."""
    segments: Annotated[list[SegmentSpec], Field(min_length=1, max_length=200)]
    """Motions, one after the other."""
    dither: DitherSpec | None = None
    """A small vibration on top of it all, to break friction."""
