"""Limits of the guards for the arm and the pads: following error and contact force."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, Protocol

from pydantic import Discriminator, Field, FiniteFloat, Tag, ValidationInfo, field_validator

from palmd.config.fields import Plausible, Positive, Strict

Degrees = Annotated[FiniteFloat, Field(gt=0, le=90), Plausible(0.1, 30)]
Millimetres = Annotated[FiniteFloat, Field(gt=0, le=500), Plausible(0.2, 100)]


class FollowingError(Strict):
    """Largest distance of the arm from its delayed set-point, at rest and at the full rate; linear in between."""

    @field_validator("at_full_rate_deg", "at_full_rate_mm", check_fields=False)
    @classmethod
    def _not_below_rest(cls, value: float, info: ValidationInfo) -> float:
        rest_key = str(info.field_name).replace("full_rate", "rest")
        at_rest = info.data.get(rest_key, 0.0)
        if value < at_rest:
            raise ValueError(f"must not be less than {rest_key}, which is {at_rest:g}; got {value:g}")
        return value


class JointFollowingError(FollowingError):
    """Following error of joints that turn."""

    at_rest_deg: Degrees = 1.0
    """Largest error of each joint angle at rest."""
    at_full_rate_deg: Degrees = 6.0
    """Largest error of each joint angle at the maximum rate."""


class PalmFollowingError(JointFollowingError):
    """Following error of two palms: their angles, and the gripper of an arm that holds palm 2."""

    at_rest_mm: Millimetres = 4.0
    """Largest error of the gripper at rest."""
    at_full_rate_mm: Millimetres = 24.0
    """Largest error of the gripper at the maximum rate."""


class AxisFollowingError(FollowingError):
    """Following error of a gripper that is moved along axes."""

    at_rest_mm: Millimetres = 1.0
    """Largest error along each axis at rest."""
    at_full_rate_mm: Millimetres = 3.0
    """Largest error along each axis at the maximum speed."""


Newtons = Annotated[Positive, Field(le=50), Plausible(0.3, 20)]


PadForces = dict[str, Newtons]
"""Limits by the pads' names under `pads`; omitted pads have their default."""


def _number_or_pads(value: Any) -> str:
    return "<pads>" if isinstance(value, dict) else "<number>"


ForceLimits = Annotated[
    Annotated[Newtons, Tag("<number>")] | Annotated[PadForces, Tag("<pads>")], Discriminator(_number_or_pads)
]
"""One limit for all pads, or one for each."""


def only_palms(palms: Iterable[int]) -> Callable[[float | PadForces | None], float | PadForces | None]:
    """Validator of limits that may name only the pads of these palms."""
    names = [f"palm{palm}" for palm in palms]

    def check(limits: float | PadForces | None) -> float | PadForces | None:
        if isinstance(limits, dict) and (unknown := [name for name in limits if name not in names]):
            known = f"{', '.join(names[:-1])} or {names[-1]}"
            raise ValueError(f"unknown pad {unknown[0]}: use {known}, or one number for all")
        return limits

    return check


class _HasFullScale(Protocol):
    @property
    def full_scale_n(self) -> float: ...


def pad_force_limits(limits: float | PadForces | None, pads: Mapping[int, _HasFullScale]) -> tuple[float, ...]:
    """Force limit (N) of each pad; `pads` by their numbers."""
    return force_limits(limits, {f"palm{number}": pad.full_scale_n for number, pad in pads.items()})


def force_limits(limits: float | PadForces | None, full_scales: Mapping[str, float]) -> tuple[float, ...]:
    """Force limit (N) of each pad: the configured one, else the pad's full scale; `full_scales` by the pads' names."""
    if isinstance(limits, float):
        return (limits,) * len(full_scales)
    given = limits or {}
    return tuple(given.get(name, full) for name, full in full_scales.items())
