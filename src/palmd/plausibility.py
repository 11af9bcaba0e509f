"""Checks a configuration for implausible values: mistaken units, and impossible rigs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from palmd.config.any_config import AnyConfig
from palmd.config.arms import AdeptConfig
from palmd.config.fields import Plausible, size, unit_of
from palmd.config.two_palms import Config, RigConfig
from palmd.system.mechanism import PALMS
from palmd.systems import LIVE, load_part
from palmd.yamlfile import Document, Loc

Value = float | tuple[float, ...]

ARM_NEAREST_MM = 150.0
"""No arm of this kind works closer to its own base."""


@dataclass(frozen=True, slots=True)
class Slip:
    """A value in another unit than the key's: the key's value is `factor` × value, or factor/value if `inverted`."""

    factor: float
    inverted: bool = False

    def in_key_unit(self, value: Value) -> Value:
        """The value in the key's unit."""
        if isinstance(value, tuple):
            return tuple(self._converted(each) for each in value)
        return self._converted(value)

    def _converted(self, value: float) -> float:
        if self.inverted:
            return self.factor / value if value else value
        return self.factor * value


_RADIANS = Slip(math.degrees(1.0))
UNIT_SLIPS: Mapping[str, tuple[Slip, ...]] = {
    "mm": (Slip(1e3), Slip(1e-3), Slip(10.0), Slip(25.4)),  # m, µm, cm, inches
    "°": (_RADIANS,),
    "°/s": (_RADIANS,),
    "°/s²": (_RADIANS,),
    "m/s²": (Slip(0.01), Slip(0.001)),  # cm/s², mm/s²
    "ms": (Slip(1e3), Slip(1e-3)),
    "Hz": (Slip(1.0, inverted=True), Slip(1e3, inverted=True)),  # the period in s, in ms
    "counts/mm": (Slip(1.0, inverted=True), Slip(1.0 / 25.4), Slip(1e-3)),  # mm/count, counts/inch, counts/m
    "N/count": (Slip(1e-3), Slip(1.0, inverted=True)),  # mN/count, counts/N
    "mm/N": (Slip(1e3),),
    "": (Slip(0.01),),  # per cent instead of a fraction
}
"""By the unit of the key."""


def implausible(document: Document, config: AnyConfig) -> list[str]:
    """Values to check again, each with its position: `file:line:col: what`; defaults are always plausible."""
    texts = {loc: text for loc, text in _implausible_values(config) if loc in document.values}
    joint_check = LIVE[config.system].implausible
    findings = load_part(joint_check)(config) if joint_check else ()
    texts |= {loc: text for loc, text in findings if loc in document.values and loc not in texts}
    placed = sorted((document.place(loc), f"{'.'.join(map(str, loc))}: {text}") for loc, text in texts.items())
    return [document.line(place, text) for place, text in placed]


def _implausible_values(model: BaseModel, around: Loc = ()) -> Iterator[tuple[Loc, str]]:
    for name, field in type(model).model_fields.items():
        value, loc = getattr(model, name), (*around, name)
        if isinstance(value, BaseModel):
            yield from _implausible_values(value, loc)
            continue
        plausible_range = _plausible(field)
        if plausible_range is not None and not plausible_range.holds(value):
            yield loc, describe_implausible(name, value, plausible_range, field.default)


def _plausible(field: FieldInfo) -> Plausible | None:
    return next((each for each in field.metadata if isinstance(each, Plausible)), None)


def describe_implausible(key: str, value: Value, plausible_range: Plausible, default: Value) -> str:
    """What is implausible about a key's value, and the value probably meant: the slip closest to the default."""
    unit = unit_of(key)
    text = f"{_formatted(value, unit)} is implausible: {plausible_range}{f' {unit}' if unit else ''} is usual"
    converted = (slip.in_key_unit(value) for slip in UNIT_SLIPS.get(unit, ()))
    candidates = [each for each in converted if plausible_range.holds(each)]
    if not candidates:
        return text
    best = min(candidates, key=lambda each: abs(math.log(size(each) / size(default))) if size(each) else math.inf)
    return f"{text}; did you mean {_formatted(best, unit)}?"


def implausible_rig(config: Config) -> Iterator[tuple[Loc, str]]:
    """Implausible combinations of keys of two palms, and where."""
    if isinstance(config.arm, AdeptConfig):
        yield from _implausible_base(config.arm, config.rig)
    for palm, length_mm in zip(PALMS, config.rig.palm_lengths_mm, strict=True):
        pad = config.pads.of(palm)
        if pad.length_mm > length_mm:
            palm_text = f"a palm of {length_mm:g} mm (rig.palm{palm}_length_mm)"
            text = f"the pad would reach {pad.length_mm:g} mm along {palm_text}"
            yield ("pads", f"palm{palm}", "length_mm"), text
        if abs(pad.zero_mm) > pad.length_mm:
            zero_text = f"{pad.zero_mm:g} mm from the hinge, but the pad ends at {pad.length_mm:g} mm (length_mm)"
            yield ("pads", f"palm{palm}", "zero_mm"), f"count 0 would be {zero_text}"


def _implausible_base(arm: AdeptConfig, rig: RigConfig) -> Iterator[tuple[Loc, str]]:
    arm_mm = (arm.base_x_mm, arm.base_y_mm)
    distance_mm = math.dist(arm_mm, rig.base_mm)
    if distance_mm < ARM_NEAREST_MM:
        text = (
            f"the arm's base would be {distance_mm:.3g} mm from the hinge of palm {PALMS[0]} (rig.base_mm), and no arm"
            f" works nearer to its base than {ARM_NEAREST_MM:g} mm"
        )
        metres = tuple(1e3 * each for each in arm_mm)
        if ARM_NEAREST_MM <= math.dist(metres, rig.base_mm) <= 1e4:
            text += f"; did you mean {metres[0]:g} mm?"
        yield ("arm", "base_x_mm"), text


def _formatted(value: Value, unit: str) -> str:
    values = [f"{each:.4g}" for each in (value if isinstance(value, tuple) else (value,))]
    number = f"[{', '.join(values)}]" if isinstance(value, tuple) else values[0]
    return f"{number} {unit}".rstrip() if unit != "°" else f"{number}°"
