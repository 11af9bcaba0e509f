"""Read the block `rig.vibration` in line 1 of an event log."""

from __future__ import annotations

from typing import Any, get_args

from palmd.record.logline import BadLineError, Line, block, not_negative, positive, shown
from palmd.system.vibration import (
    INDEPENDENT,
    VIBRATION_KEYS,
    VIBRATION_SD_KEYS,
    Relation,
    Vibration,
    VibrationLaw,
)

_MORE_THAN_ZERO = ("frequency", "speed")


def read_vibration(rig: Line) -> Vibration:
    """The palms' vibration from the header's rig, independent if it is missing. Raises BadLineError."""
    if rig.get("vibration") is None:
        return INDEPENDENT
    line = block(rig, "vibration")
    values: dict[str, Any] = {
        "relation": _one_of(line, "relation", get_args(Relation), "independent"),
        "law": _one_of(line, "law", get_args(VibrationLaw), "sign_pairs"),
    }
    for name, key in VIBRATION_KEYS.items():
        if line.get(key) is not None:
            values[name] = positive(line, key) if name in _MORE_THAN_ZERO else not_negative(line, key)
        sd_key, literal = VIBRATION_SD_KEYS[f"{name}_sd"], f"{key}_sd"  # `speed_m_s_sd` is accepted for `speed_sd_m_s`
        given = next((each for each in (sd_key, literal) if line.get(each) is not None), None)
        if given is not None:
            values[f"{name}_sd"] = not_negative(line, given)
    if values.get("transmission", 0.0) > 1.0:
        raise BadLineError(f"vibration.transmission must be 0 to 1, got {values['transmission']:g}")
    return Vibration(**values)


def _one_of(line: Line, key: str, allowed: tuple[str, ...], default: str) -> str:
    value = line.get(key)
    if value is None:
        return default
    if value not in allowed:
        raise BadLineError(f"vibration.{key} must be one of {', '.join(allowed)}; got {shown(value)}")
    return str(value)
