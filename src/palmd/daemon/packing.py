"""What the daemon publishes as bytes: msgpack, in which vectors of NumPy are lists of numbers like any others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgpack
import numpy as np

from palmd.events import FloatArray

_FLOAT64 = 0xCB  # before each number, which has its high byte first
_NUMBER = np.dtype([("kind", np.uint8), ("value", ">f8")])


class FieldsPacker:
    """Packs messages; safe in the loop."""

    def __init__(self) -> None:
        self._packer = msgpack.Packer()  # one for all: each has a megabyte of its own

    def __call__(self, fields: Mapping[str, Any]) -> bytes:
        """A message's payload; a value may be a vector (N,) of float64, which takes a sixth of a list's time."""
        try:
            payload: bytes = self._packer.pack(fields)
        except TypeError:  # it has vectors, or what is no message at all
            parts = [self._packer.pack_map_header(len(fields))]
            for name, value in fields.items():
                parts.append(self._packer.pack(name))
                if isinstance(value, np.ndarray):
                    parts += self._packer.pack_array_header(len(value)), _told(value)
                else:
                    parts.append(self._packer.pack(value))
            return b"".join(parts)
        return payload


def _told(numbers: FloatArray) -> memoryview:
    told = np.empty(len(numbers), _NUMBER)
    told["kind"], told["value"] = _FLOAT64, numbers
    return told.view(np.uint8).data  # `tobytes` would copy number by number
