"""Motion plans as they stand in their files: what those of all systems have."""

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
        """Them, in the order of the joints."""
        return tuple(getattr(self, name) for name in type(self).model_fields)


class HoldSpec(Strict):
    """Stand still."""

    hold_s: Duration
    """For how long."""


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


class AnyPlanSpec(Strict):
    """What the motion plans of all systems have; each is a model of its own."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    """What it is called on the bus."""
    segments: Annotated[list[Any], Field(min_length=1, max_length=200)]
    """Motions, one after the other."""
