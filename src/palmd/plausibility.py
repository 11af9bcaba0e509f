"""What in a configuration can hardly be meant: slips of unit, and rigs that cannot be."""

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
"""No arm of this kind works so near to its own base."""


@dataclass(frozen=True, slots=True)
class Slip:
    """A value in another unit than the key's: `factor` makes the key's unit of it, after turning it over or not."""

    factor: float
    turned_over: bool = False

    def mended(self, value: Value) -> Value:
        """The value in the key's unit."""
        if isinstance(value, tuple):
            return tuple(self._mended(each) for each in value)
        return self._mended(value)

    def _mended(self, value: float) -> float:
        if self.turned_over:
            return self.factor / value if value else value
        return self.factor * value


_RADIANS = Slip(math.degrees(1.0))
SLIPS: Mapping[str, tuple[Slip, ...]] = {
    "mm": (Slip(1e3), Slip(1e-3), Slip(10.0), Slip(25.4)),  # m, µm, cm, inches
    "°": (_RADIANS,),
    "°/s": (_RADIANS,),
    "°/s²": (_RADIANS,),
    "m/s²": (Slip(0.01), Slip(0.001)),  # cm/s², mm/s²
    "ms": (Slip(1e3), Slip(1e-3)),
    "Hz": (Slip(1.0, turned_over=True), Slip(1e3, turned_over=True)),  # the period in s, in ms
    "counts/mm": (Slip(1.0, turned_over=True), Slip(1.0 / 25.4), Slip(1e-3)),  # mm/count, counts/inch, counts/m
    "N/count": (Slip(1e-3), Slip(1.0, turned_over=True)),  # mN/count, counts/N
    "mm/N": (Slip(1e3),),
    "": (Slip(0.01),),  # per cent, of what is a share
}
"""By the unit of the key."""


def implausible(document: Document, config: AnyConfig) -> list[str]:
    """What should be looked at again, each with its place: `file:line:col: what`; a default is always plausible."""
    told = {loc: text for loc, text in _odd_values(config) if loc in document.values}
    together = LIVE[config.system].odd
    odd = load_part(together)(config) if together else ()
    told |= {loc: text for loc, text in odd if loc in document.values and loc not in told}
    placed = sorted((document.place(loc), f"{'.'.join(map(str, loc))}: {text}") for loc, text in told.items())
    return [document.line(place, text) for place, text in placed]


def _odd_values(model: BaseModel, around: Loc = ()) -> Iterator[tuple[Loc, str]]:
    for name, field in type(model).model_fields.items():
        value, loc = getattr(model, name), (*around, name)
        if isinstance(value, BaseModel):
            yield from _odd_values(value, loc)
            continue
        usual = _plausible(field)
        if usual is not None and not usual.holds(value):
            yield loc, odd(name, value, usual, field.default)


def _plausible(field: FieldInfo) -> Plausible | None:
    return next((each for each in field.metadata if isinstance(each, Plausible)), None)


def odd(key: str, value: Value, usual: Plausible, default: Value) -> str:
    """What is odd about a key's value, and what may be meant instead: of all slips the one nearest to the default."""
    unit = unit_of(key)
    text = f"{_written(value, unit)} can hardly be right: {usual}{f' {unit}' if unit else ''} is usual"
    mended = (slip.mended(value) for slip in SLIPS.get(unit, ()))
    plausible = [each for each in mended if usual.holds(each)]
    if not plausible:
        return text
    meant = min(plausible, key=lambda each: abs(math.log(size(each) / size(default))) if size(each) else math.inf)
    return f"{text}; is {_written(meant, unit)} meant?"


def odd_rig(config: Config) -> Iterator[tuple[Loc, str]]:
    """What of two palms only several keys together tell, and where."""
    if isinstance(config.arm, AdeptConfig):
        yield from _odd_base(config.arm, config.rig)
    for palm, length_mm in zip(PALMS, config.rig.palm_lengths_mm, strict=True):
        pad = config.pads.of(palm)
        if pad.length_mm > length_mm:
            whole = f"a palm of {length_mm:g} mm (rig.palm{palm}_length_mm)"
            text = f"the pad would reach {pad.length_mm:g} mm along {whole}"
            yield ("pads", f"palm{palm}", "length_mm"), text
        if abs(pad.zero_mm) > pad.length_mm:
            beyond = f"{pad.zero_mm:g} mm from the hinge, but the pad ends at {pad.length_mm:g} mm (length_mm)"
            yield ("pads", f"palm{palm}", "zero_mm"), f"count 0 would be {beyond}"


def _odd_base(arm: AdeptConfig, rig: RigConfig) -> Iterator[tuple[Loc, str]]:
    arm_mm = (arm.base_x_mm, arm.base_y_mm)
    away_mm = math.dist(arm_mm, rig.base_mm)
    if away_mm < ARM_NEAREST_MM:
        text = (
            f"the arm's base would be {away_mm:.3g} mm from where palm {PALMS[0]} is hinged (rig.base_mm), and no arm"
            f" works nearer to its base than {ARM_NEAREST_MM:g} mm"
        )
        metres = tuple(1e3 * each for each in arm_mm)
        if ARM_NEAREST_MM <= math.dist(metres, rig.base_mm) <= 1e4:
            text += f"; is {metres[0]:g} mm meant?"
        yield ("arm", "base_x_mm"), text


def _written(value: Value, unit: str) -> str:
    values = [f"{each:.4g}" for each in (value if isinstance(value, tuple) else (value,))]
    number = f"[{', '.join(values)}]" if isinstance(value, tuple) else values[0]
    return f"{number} {unit}".rstrip() if unit != "°" else f"{number}°"
