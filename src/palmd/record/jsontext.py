"""A map as one line of JSON: the bytes of `json.dumps`, several times faster if most values are numbers.

`json.dumps` spends most of its time on shortest decimals. They are compiled here (`jsontext.c`); without a compiler
`json.dumps` is used. Not for use inside the loop.
"""

from __future__ import annotations

import ctypes
import json
from array import array
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from palmd.jsonvalues import or_none
from palmd.model.compiled import load_written

PLACEHOLDER = "\x01"  # stands for a number; JSON text never contains this character
MAX_NUMBER_BYTES = 25  # length of the longest number, for example -1.2345678901234567e-308
_TWO_WORDS = 1 << 64

_encoded = json.JSONEncoder(allow_nan=False).encode


def as_json(fields: Mapping[str, Any]) -> str:
    """As `json.dumps`, but NaN and infinities become null; raises what that raises."""
    library = _library()
    if library is None:
        return _encoded(or_none(fields))
    numbers = array("d")
    text = _with_placeholders(fields, numbers).encode("ascii")
    out = ctypes.create_string_buffer(len(text) + MAX_NUMBER_BYTES * len(numbers))
    at, _ = numbers.buffer_info()
    length: int = library.jsontext_fill(_powers(), text, len(text), at, out)
    return out.raw[:length].decode("ascii")


def backend() -> str:
    """Which code formats numbers: `c`, or `python` without a compiler."""
    return "python" if _library() is None else "c"


def _with_placeholders(fields: Mapping[str, Any], numbers: array[float]) -> str:
    """The text with a placeholder per number; appends the numbers, also of nested maps, to `numbers`."""
    values, rest = fields.values(), []
    for value in values:
        if type(value) is float:
            numbers.append(value)
        elif type(value) is dict:
            rest.append(_with_placeholders(value, numbers))
        elif type(value) is int:
            rest.append(str(value))
        elif type(value) is bool:
            rest.append("true" if value else "false")
        else:
            rest.append(_encoded(or_none(value)))
    return _template(tuple(fields), tuple(map(type, values))) % tuple(rest)


@cache
def _template(names: tuple[str, ...], kinds: tuple[type, ...]) -> str:
    """Format string of a map: placeholders for floats, %s for all other values."""
    keys = (json.dumps(name).replace("%", "%%") for name in names)
    values = (PLACEHOLDER if kind is float else "%s" for kind in kinds)
    return f"{{{', '.join(map(': '.join, zip(keys, values, strict=True)))}}}"


@cache
def _library() -> ctypes.CDLL | None:
    library = load_written("jsontext", Path(__file__).with_name("jsontext.c"))
    if library is None:
        return None
    pointer, number = ctypes.c_void_p, ctypes.c_long
    library.jsontext_fill.argtypes = (pointer, ctypes.c_char_p, number, pointer, ctypes.c_char_p)
    library.jsontext_fill.restype = number
    return library


@cache
def _powers() -> ctypes.Array[ctypes.c_uint64]:
    """Powers of ten in the C layout: upper half of each, then lower half."""
    library = _library()
    assert library is not None
    least, count = (ctypes.c_long * 2).in_dll(library, "jsontext_powers")
    halves = (half for k in range(least, least + count) for half in divmod(_power(k), _TWO_WORDS))
    return (ctypes.c_uint64 * (2 * count))(*halves)


def _power(k: int) -> int:
    """The 128 leading bits of 10^k, plus one unit in the last place."""
    over, under = (10**k, 1) if k >= 0 else (1, 10**-k)
    shift = 127 - ((k * 1741647) >> 19)
    return ((over << shift) // under if shift >= 0 else over // (under << -shift)) + 1
