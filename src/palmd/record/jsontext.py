"""A map as one line of JSON: bytes as `json.dumps` has them, several times faster where most values are numbers.

Most of the time that `json.dumps` takes goes into the shortest decimals. Those are compiled (`jsontext.c`); without a
compiler `json.dumps` serves. Not for use inside the loop.
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

PLACE = "\x01"  # of a number: JSON has this character in no other place
LONGEST = 25  # of a number's text: -1.2345678901234567e-308
_TWO_WORDS = 1 << 64

_encoded = json.JSONEncoder(allow_nan=False).encode


def as_json(fields: Mapping[str, Any]) -> str:
    """As `json.dumps`, but null for every number that is none; raises what that raises."""
    library = _library()
    if library is None:
        return _encoded(or_none(fields))
    numbers = array("d")
    text = _with_places(fields, numbers).encode("ascii")
    out = ctypes.create_string_buffer(len(text) + LONGEST * len(numbers))
    at, _ = numbers.buffer_info()
    length: int = library.jsontext_fill(_powers(), text, len(text), at, out)
    return out.raw[:length].decode("ascii")


def backend() -> str:
    """What writes numbers: compiled C, or Python where there is no compiler."""
    return "python" if _library() is None else "c"


def _with_places(fields: Mapping[str, Any], numbers: array[float]) -> str:
    """The text with places for the `numbers`, which it adds to: its own, and those of maps in it."""
    values, rest = fields.values(), []
    for value in values:
        if type(value) is float:
            numbers.append(value)
        elif type(value) is dict:
            rest.append(_with_places(value, numbers))
        elif type(value) is int:
            rest.append(str(value))
        elif type(value) is bool:
            rest.append("true" if value else "false")
        else:
            rest.append(_encoded(or_none(value)))
    return _form(tuple(fields), tuple(map(type, values))) % tuple(rest)


@cache
def _form(names: tuple[str, ...], kinds: tuple[type, ...]) -> str:
    """The text with places for numbers, and %s for all else."""
    told = (json.dumps(name).replace("%", "%%") for name in names)
    places = (PLACE if kind is float else "%s" for kind in kinds)
    return f"{{{', '.join(map(': '.join, zip(told, places, strict=True)))}}}"


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
    """Of ten, as C wants them: the upper half of each, then the lower."""
    library = _library()
    assert library is not None
    least, count = (ctypes.c_long * 2).in_dll(library, "jsontext_powers")
    halves = (half for k in range(least, least + count) for half in divmod(_power(k), _TWO_WORDS))
    return (ctypes.c_uint64 * (2 * count))(*halves)


def _power(k: int) -> int:
    """The 128 leading bits of 10^k, and one more in the last."""
    over, under = (10**k, 1) if k >= 0 else (1, 10**-k)
    shift = 127 - ((k * 1741647) >> 19)
    return ((over << shift) // under if shift >= 0 else over // (under << -shift)) + 1
