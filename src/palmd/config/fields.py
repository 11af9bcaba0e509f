"""Building blocks of configuration and plan models: strict base class, units, ranges, and unions of kinds.

`palmd.yamlfile` reads files and locates errors (file:line:col); the models only define what is allowed, and their
error texts name the bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, PlainValidator, ValidationInfo

BAUDS = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
SERVO_BAUDS = (115200, 1000000, 2000000, 3000000, 4000000)


def one_of(*allowed: int) -> AfterValidator:
    """An integer from a short list (Literal would accept `true` for 1)."""

    def check(value: int) -> int:
        if value not in allowed:
            raise ValueError(f"must be {check.__doc__}; got {value}")
        return value

    check.__doc__ = f"one of {', '.join(map(str, allowed))}"
    return AfterValidator(check)


def _rising_within(low: float, high: float) -> Callable[[tuple[float, float]], tuple[float, float]]:
    def check(pair: tuple[float, float]) -> tuple[float, float]:
        if not low <= pair[0] < pair[1] <= high:
            raise ValueError(f"must be {check.__doc__}; got [{pair[0]:g}, {pair[1]:g}]")
        return pair

    check.__doc__ = f"[low, high] with {low:g} ≤ low < high ≤ {high:g}"
    return check


def _relative_to_file(value: object, info: ValidationInfo) -> Path:
    """A path as text, relative to the folder of the file that contains it (validation context `folder`)."""
    if not isinstance(value, str) or not value.strip():
        raise ValueError("must be a path as text")
    folder: Path = (info.context or {}).get("folder", Path())
    try:
        return folder / Path(value).expanduser()
    except RuntimeError:
        raise ValueError(f"{value}: unknown home folder; write the full path") from None


def exists(path: Path) -> bool:
    """Whether a file or folder exists; raises ValueError if that cannot be determined."""
    try:
        return path.exists()
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from None


UNITS = {
    "counts_per_mm": "counts/mm", "newtons_per_count": "N/count", "_mm_per_n": "mm/N",
    "_m_s2": "m/s²", "_deg_s2": "°/s²", "_m_s": "m/s", "_deg_s": "°/s",
    "_deg": "°", "_mm": "mm", "_n": "N", "_hz": "Hz", "_ms": "ms", "_s": "s", "baud": "bit/s",
}  # fmt: skip
"""Units by the ending of a key."""


def unit_of(key: str) -> str:
    """The unit in a key's name, empty if there is none."""
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")


def size(value: float | tuple[float, ...]) -> float:
    """Absolute value; of several values, the largest."""
    return max(map(abs, value)) if isinstance(value, tuple) else abs(value)


@dataclass(frozen=True, slots=True)
class Plausible:
    """Plausible range of an absolute value: `low` to `high`, or 0 if `or_zero`; of two values the larger counts.

    Other values are accepted too; `palmd check` asks the user to confirm them.
    """

    low: float
    high: float
    or_zero: bool = False

    def holds(self, value: float | tuple[float, ...]) -> bool:
        """Whether a value, or the larger of two, is plausible."""
        return self.low <= size(value) <= self.high or (self.or_zero and size(value) == 0.0)

    def __str__(self) -> str:
        return ("0, or " if self.or_zero else "") + f"{self.low:g} to {self.high:g}"


Positive = Annotated[FiniteFloat, Field(gt=0)]
NotNegative = Annotated[FiniteFloat, Field(ge=0)]
Baud = Annotated[int, one_of(*BAUDS)]
ServoBaud = Annotated[int, one_of(*SERVO_BAUDS)]
AnyBaud = Annotated[int, one_of(*sorted({*BAUDS, *SERVO_BAUDS}))]
PortPath = Annotated[str, Field(min_length=1)]
Pair = Annotated[tuple[FiniteFloat, FiniteFloat], Field(strict=False)]  # a YAML list is not a tuple
OpeningRange = Annotated[Pair, AfterValidator(_rising_within(1.0, 179.0))]
AngleRange = Annotated[Pair, AfterValidator(_rising_within(0.0, 180.0))]
TiltRange = Annotated[Pair, AfterValidator(_rising_within(-30.0, 180.0))]
FilePath = Annotated[Path, PlainValidator(_relative_to_file)]


class Strict(BaseModel):
    """Base of all models: unknown keys, wrong types and later changes are errors."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


def by_kind(usual: str) -> Callable[[Any], str]:
    """Discriminator of a union by `kind`; its tags are in angle brackets, so that they differ from keys of the file."""

    def tag(value: Any) -> str:
        kind = value.get("kind", usual) if isinstance(value, dict) else getattr(value, "kind", usual)
        return f"<{kind}>"

    return tag
