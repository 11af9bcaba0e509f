"""Check of published messages against the tables of `palmd.quantities`."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from palmd.quantities import STAMP, Kind, Topic
from palmd.topics import TOPICS

_WITH_SD = {quantity.name for topic in TOPICS for quantity in topic.quantities if quantity.uncertain}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_list(of: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: isinstance(value, list) and all(map(of, value))


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_sds(value: object) -> bool:
    return isinstance(value, dict) and all(name in _WITH_SD and _is_number(sd) for name, sd in value.items())


_CHECKS: dict[Kind, Callable[[object], bool]] = {
    "number": _is_number,
    "bool": lambda value: isinstance(value, bool),
    "text": _is_text,
    "numbers": _is_list(_is_number),
    "texts": _is_list(_is_text),
    "sds": _is_sds,
}


def validate(topic: Topic, fields: Mapping[str, object]) -> list[str]:
    """Errors of a stamped message of `topic`, in words; empty if there are none."""
    expected = {field.name: field for field in (*STAMP, *topic.quantities)}
    families = [field for name, field in expected.items() if name.endswith("*")]
    errors = [f"{topic.name}: {name} is missing" for name in expected if name not in fields and not name.endswith("*")]
    for name, value in fields.items():
        family = next((f for f in families if name.startswith(f.name[:-1])), None)
        field = expected.get(name, family)
        if field is None:
            errors.append(f"{topic.name}: {name} is not in the table")
        elif not _CHECKS[field.kind](value):
            errors.append(f"{topic.name}: {name} must be {field.kind}, not {value!r}")
    return errors
