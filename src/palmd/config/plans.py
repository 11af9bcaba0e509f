"""Parts that the motion plans of all systems have in common."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, FiniteFloat, PlainValidator

from palmd.config.fields import Strict

MAX_DURATION_S = 3600.0


def _repeat(value: object) -> int | Literal["forever"]:
    """A whole number from 1 to 10000, or forever."""
    if value == "forever":
        return "forever"
    if type(value) is int and 1 <= value <= 10_000:
        return value
    raise ValueError(f"must be a whole number from 1 to 10000, or forever; got {value!r}")


Duration = Annotated[FiniteFloat, Field(gt=0, le=MAX_DURATION_S)]
SwingFrequency = Annotated[FiniteFloat, Field(gt=0, le=5)]
Repeat = Annotated[int | Literal["forever"], PlainValidator(_repeat)]


class JointValues(Strict):
    """One value for each joint."""

    def each(self) -> tuple[float | None, ...]:
        """The values, in the order of the joints."""
        return tuple(getattr(self, name) for name in type(self).model_fields)


class HoldSpec(Strict):
    """Stand still."""

    hold_s: Duration
    """Duration."""


class ExploreGoal(Strict):
    """When an exploration ends."""

    coverage: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.95
    """Required share of the reachable normals."""
    band_mm: Annotated[FiniteFloat, Field(gt=0, le=10)] | None = None
    """Required standard deviation of the outline at all of them; if omitted, only coverage counts."""
    time_limit_s: Duration = 60.0
    """Time limit."""


class ExploreSpec(Strict):
    """Closed-loop motion that touches the parts of the outline not touched yet."""

    explore: ExploreGoal
    """When it ends; must be the last segment."""


def one_key_of(kinds: tuple[str, ...]) -> Discriminator:
    """Discriminator of segment models: each has exactly one of these keys."""

    def kind(value: Any) -> str | None:
        """The union's tag, in angle brackets, so that it differs from keys of the file."""
        found = [each for each in kinds if each in value] if isinstance(value, dict) else []
        return f"<{found[0]}>" if len(found) == 1 else None

    text = f"a segment needs exactly one of the keys {', '.join(kinds)}"
    return Discriminator(kind, custom_error_type="segment_kind", custom_error_message=text)


class AnyPlanSpec(Strict):
    """Base of the motion plans of all systems."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    """Name of the plan on the bus."""
    segments: Annotated[list[Any], Field(min_length=1, max_length=200)]
    """Motions in the order of execution."""
