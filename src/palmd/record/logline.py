"""One line of an event log: decoding, and checks of its fields and of its block `rig.vibration`. Pure."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any, get_args

from palmd.system.vibration import (
    INDEPENDENT,
    VIBRATION_KEYS,
    VIBRATION_SD_KEYS,
    Relation,
    Vibration,
    VibrationLaw,
)

MAX_LINE_BYTES = 1 << 20

Line = dict[str, Any]


class BadLineError(ValueError):
    """What is wrong with one line; the caller adds file and line number."""


def decoded(raw: bytes) -> Line:
    """The JSON object on a line; raises BadLineError, as all functions here do."""
    if len(raw) > MAX_LINE_BYTES:
        raise BadLineError(f"the line is longer than {MAX_LINE_BYTES} bytes; an event log has one event per line")
    try:
        line = json.loads(raw.decode())
    except UnicodeDecodeError:
        raise BadLineError("not text (UTF-8)") from None
    except (ValueError, RecursionError) as error:
        what = error.msg if isinstance(error, json.JSONDecodeError) else "a number is too long or nesting too deep"
        raise BadLineError(f"not JSON: {what}") from None
    if not isinstance(line, dict):
        raise BadLineError(f"must be an object {{…}}, got {shown(line)}")
    return line


def block(line: Line, key: str) -> Line:
    """The object under a required key."""
    value = line.get(key)
    if not isinstance(value, dict):
        raise BadLineError(f"{key} is missing" if value is None else f"{key} must be an object {{…}}")
    return value


def number(line: Line, key: str) -> float:
    """The finite number under a required key."""
    value = line.get(key)
    if (type(value) is float or type(value) is int) and abs(value) < math.inf:
        try:
            return float(value)
        except OverflowError:
            pass
    if key not in line:
        raise BadLineError(f"{key} is missing")
    raise BadLineError(f"{key} must be a finite number, got {shown(value)}")


def optional(line: Line, key: str) -> float | None:
    """The finite number under a key; None if it is missing or null."""
    return None if line.get(key) is None else number(line, key)


def positive(line: Line, key: str, default: float | None = None) -> float:
    """A number > 0; `default`, if given, replaces a missing one."""
    return _bounded(line, key, default, lambda value: value > 0.0, "more than 0")


def not_negative(line: Line, key: str, default: float | None = None) -> float:
    """A number ≥ 0; `default`, if given, replaces a missing one."""
    return _bounded(line, key, default, lambda value: value >= 0.0, "at least 0")


def _bounded(line: Line, key: str, default: float | None, allowed: Callable[[float], bool], bound: str) -> float:
    if default is not None and line.get(key) is None:
        return default
    value = number(line, key)
    if not allowed(value):
        raise BadLineError(f"{key} must be {bound}, got {value:g}")
    return value


def shown(value: object) -> str:
    """A value as text for an error message, at most 40 characters."""
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    text = json.dumps(value) if not isinstance(value, int) or abs(value) < 10**20 else "a number above 1e20"
    return text if len(text) <= 40 else text[:37] + "…"


_MORE_THAN_ZERO = ("frequency", "speed")


def read_vibration(rig: Line) -> Vibration:
    """The palms' vibration from the header's rig, independent if it is missing. Raises BadLineError."""
    if rig.get("vibration") is None:
        return INDEPENDENT
    line = block(rig, "vibration")
    values: dict[str, Any] = {
        "relation": _one_of_words(line, "relation", get_args(Relation), "independent"),
        "law": _one_of_words(line, "law", get_args(VibrationLaw), "sign_pairs"),
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


def _one_of_words(line: Line, key: str, allowed: tuple[str, ...], default: str) -> str:
    value = line.get(key)
    if value is None:
        return default
    if value not in allowed:
        raise BadLineError(f"vibration.{key} must be one of {', '.join(allowed)}; got {shown(value)}")
    return str(value)
