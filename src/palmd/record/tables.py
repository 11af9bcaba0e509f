"""Messages as rows of a table: flattening of nested maps, and the columns of a run. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from palmd.messages import Fields
from palmd.quantities import STAMP

if TYPE_CHECKING:
    from palmd.record.run import AnyRun

_FIRST = tuple(field.name for field in STAMP)


def flat(fields: Fields) -> Iterator[tuple[str, Any]]:
    """Each value with its name; values of nested maps are named `map.name`."""
    for name, value in fields.items():
        if isinstance(value, dict):
            yield from ((f"{name}.{inner}", each) for inner, each in flat(value))
        else:
            yield name, value


def field_examples(run: AnyRun, done: Callable[[], None]) -> dict[str, Fields]:
    """By topic: every field that occurs in any of its messages, with the first value of each; stamp fields first.

    Nested maps are merged in the same way. `done` is called after each message. Raises RunError, OSError.
    """
    found: dict[str, Fields] = {}
    for message in run.messages():
        _gather(found.setdefault(message.topic, {}), message.fields)
        done()
    return {topic: _stamp_first(fields) for topic, fields in found.items()}


def _gather(known: Fields, fields: Fields) -> None:
    for name, value in fields.items():
        if isinstance(value, dict):
            _gather(known.setdefault(name, {}), value)
        elif name not in known or known[name] == []:  # an empty list does not show the type of its elements
            known[name] = value


def _stamp_first(fields: Fields) -> Fields:
    names = [name for name in _FIRST if name in fields]
    return {name: fields[name] for name in (*names, *(name for name in fields if name not in names))}
