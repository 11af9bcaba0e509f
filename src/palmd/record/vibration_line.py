"""The block `rig.vibration` in line 1 of an event log, read and written."""

from __future__ import annotations

from typing import Any, get_args

from palmd.record.logline import BadLineError, Line, block, not_negative, positive, shown
from palmd.system.vibration import INDEPENDENT, Relation, Vibration, VibrationLaw

_POSITIVE = {"frequency": "frequency_hz", "speed": "speed_m_s"}
_KEYS = _POSITIVE | {"transmission": "transmission"}
_SD_KEYS = {"frequency_sd": "frequency_sd_hz", "speed_sd": "speed_sd_m_s", "transmission_sd": "transmission_sd"}


def read_vibration(rig: Line) -> Vibration:
    """What the header's rig says of the palms' vibration: independent where it says nothing. Raises BadLineError."""
    if rig.get("vibration") is None:
        return INDEPENDENT
    line = block(rig, "vibration")
    values: dict[str, Any] = {
        "relation": _one_of(line, "relation", get_args(Relation), "independent"),
        "law": _one_of(line, "law", get_args(VibrationLaw), "sign_pairs"),
    }
    for name, key in _KEYS.items():
        if line.get(key) is not None:
            values[name] = positive(line, key) if name in _POSITIVE else not_negative(line, key)
        sd_key, literal = _SD_KEYS[f"{name}_sd"], f"{key}_sd"  # `speed_m_s_sd` is accepted for `speed_sd_m_s`
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


def vibration_line(vibration: Vibration) -> Line:
    """The block as a log's header has it; what is not known is left out."""
    known = {key: getattr(vibration, name) for name, key in (_KEYS | _SD_KEYS).items()}
    law = {"law": vibration.law} if vibration.law != "sign_pairs" else {}
    return {"relation": vibration.relation, **{key: value for key, value in known.items() if value is not None}, **law}
