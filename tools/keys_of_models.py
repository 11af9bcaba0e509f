"""Reference pages of configuration and plan keys, generated from their models and the text below each key."""

from __future__ import annotations

import ast
import json
import types
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

import annotated_types as at
from pydantic import AfterValidator, PlainValidator
from pydantic.fields import FieldInfo

from palmd import config
from palmd.config.fields import Plausible, Strict, unit_of

BOUNDS = ((at.Gt, "gt", ">"), (at.Ge, "ge", "≥"), (at.Lt, "lt", "<"), (at.Le, "le", "≤"))

FOLDER = Path(config.__file__).parent


class Key(NamedTuple):
    """One key as a row: path, unit, default, allowed values, usual values, meaning."""

    path: str
    unit: str
    default: str
    allowed: str
    usual: str
    meaning: str


def _texts() -> dict[tuple[str, str], str]:
    """The text below each key, by class and key."""
    found = {}
    for node in (node for path in FOLDER.glob("*.py") for node in ast.parse(path.read_text()).body):
        if isinstance(node, ast.ClassDef):
            for key, text in zip(node.body, node.body[1:], strict=False):
                if isinstance(key, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(key.target, ast.Name):
                    found[node.name, key.target.id] = ast.literal_eval(text.value)
    return found


TEXTS = _texts()


def keys(model: type[Strict], path: str = "") -> Iterator[Key]:
    """Every key of a model and its submodels, each kind of submodel once; raises KeyError if a text is missing."""
    alike: dict[type[Strict] | None, list[str]] = {}
    for name, field in model.model_fields.items():
        alike.setdefault(model_in(field.annotation), []).append(name)
    for name, field in model.model_fields.items():
        inner = model_in(field.annotation)
        if len(kinds_in(field.annotation)) > 1:
            if name == alike[inner][0]:
                yield from keys_by_kind(kinds_in(field.annotation), f"{path}{', '.join(alike[inner])}.")
            continue
        if inner is None or isinstance(field.default, str):  # a word may stand for the block
            usual = next((str(each) for each in field.metadata if isinstance(each, Plausible)), "")
            yield Key(path + name, unit_of(name), _default(field), _allowed(field), usual, text(model, name))
        if inner is not None and name == alike[inner][0]:
            yield from keys(inner, f"{path}{', '.join(alike[inner])}.")


def keys_by_kind(kinds: Sequence[type[Strict]], path: str = "") -> Iterator[Key]:
    """Keys of models distinguished by `kind`: the common ones once, then each kind's own with its name."""
    named = {get_args(kind.model_fields["kind"].annotation)[0]: list(keys(kind, path)) for kind in kinds}
    usual = next(iter(named))
    yield Key(f"{path}kind", "", usual, ", ".join(named), "", "What kind of device it is.")
    shared = [key for key in named[usual] if all(key in found for found in named.values())]
    yield from shared
    for name, found in named.items():
        own = [key for key in found if key not in shared and key.path != f"{path}kind"]
        yield from (key._replace(meaning=f"*{name}*: {key.meaning}") for key in own)


def kinds_in(kind: Any) -> list[type[Strict]]:
    """The models of a union of kinds; empty for any other type."""
    if get_origin(kind) is Annotated:
        return kinds_in(get_args(kind)[0])
    if get_origin(kind) not in (Union, types.UnionType):
        return []
    parts = [get_args(each)[0] if get_origin(each) is Annotated else each for each in get_args(kind)]
    return [
        each for each in parts if isinstance(each, type) and issubclass(each, Strict) and "kind" in each.model_fields
    ]


def text(model: type[Strict], name: str) -> str:
    """The text of a key, from the model or the base class that defines it."""
    own = next(each for each in model.__mro__ if name in vars(each).get("__annotations__", {}))
    return TEXTS[own.__name__, name]


def model_in(kind: Any) -> type[Strict] | None:
    """The model that a type is or contains, None if there is none."""
    parts = (get_args(each)[0] if get_origin(each) is Annotated else each for each in get_args(kind))
    for each in (kind, *parts):
        if isinstance(each, type) and issubclass(each, Strict):
            return each
    return None


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "needed"
    if field.default is None:
        return "–"
    return json.dumps(field.default) if isinstance(field.default, bool | tuple) else str(field.default)


def _allowed(field: FieldInfo) -> str:
    return " and ".join(dict.fromkeys(_rules(field.annotation, field.metadata)))


def _rules(kind: Any, metadata: Sequence[Any]) -> Iterator[str]:
    """The allowed values, from the type and its annotations."""
    for each in metadata:
        if isinstance(each, AfterValidator | PlainValidator):
            yield (each.func.__doc__ or "").rstrip(".").partition(", relative")[0]
        yield from (f"{sign} {getattr(each, name):g}" for bound, name, sign in BOUNDS if isinstance(each, bound))
        yield from _rules(None, [inner for inner in getattr(each, "metadata", ()) if inner is not each])
    if any(isinstance(each, PlainValidator) for each in metadata):
        return  # it alone defines the allowed values
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        yield from _rules(arguments[0], arguments[1:])
    elif origin is Literal:
        yield ", ".join(map(str, arguments))
    elif origin in (Union, types.UnionType):
        for each in arguments:
            yield from _rules(each, ())
    elif origin is tuple and any(_rules(arguments[0], ())):
        yield f"each {'; '.join(_rules(arguments[0], ()))}"
    elif kind is bool:
        yield "true, false"


# --------------------------------------------------------------------------------------------------- pages


def table(found: Iterable[Key]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows; the column of usual values only if there are any."""
    keys = list(found)
    usual = any(key.usual for key in keys)
    head = ("key", "unit", "default", "allowed", *(["usual"] if usual else []), "meaning")
    rows = [
        (f"`{key.path}`", key.unit, f"`{key.default}`", key.allowed, *([key.usual] if usual else []), key.meaning)
        for key in keys
    ]
    return head, rows


CONFIGURATION = """\
# Configuration

One YAML file describes the rig; copy `config/palmd.yaml`. Unknown keys and values outside the allowed range are
rejected: `palmd check FILE` reports all errors at once, with file, line and column. It also warns about a value whose
size (of two, the larger) is far from the *usual* range, as after a wrong unit; the daemon accepts such a value.
*needed*: there is no default. A path is relative to the folder of the file that contains it.
"""
PLANS = """\
# Motion plans

A plan is a YAML file with `segments`; `config/plans/` has examples. The palms execute the segments in order.

```yaml
name: rock
repeat: 3
segments:
  - {move: {phi1_deg: 45, phi2_deg: 90}, duration_s: 2.0}
  - {rate: {phi1_deg_s: 20, phi2_deg_s: 0}, until: {phi1_deg: 55}}
  - {hold_s: 1.0}
  - {sine: {phi1_deg: 18, phi2_deg: 8}, frequency_hz: [0.4, 0.31], duration_s: 20}
```

Segments are joined by blends within the acceleration limit, so that angles and rates are always continuous. A plan is
refused before anything moves if it leaves the limits, the workspace or the pads, if it opens the palms to
φ1 + φ2 ≥ 172°, or if there is no room for its blends; `palmd check CONFIG PLAN` reports the place in the file, and
`--draw out.svg` draws the plan.
"""
