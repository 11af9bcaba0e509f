"""Packing of published messages: msgpack, with NumPy vectors as ordinary lists of numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgpack
import numpy as np

from palmd.events import FloatArray

_FLOAT64 = 0xCB  # type byte before each number, which is big-endian
_NUMBER = np.dtype([("kind", np.uint8), ("value", ">f8")])


class FieldsPacker:
    """Packs messages; safe in the loop."""

    def __init__(self) -> None:
        self._packer = msgpack.Packer()  # shared, because each allocates 1 MB

    def __call__(self, fields: Mapping[str, Any]) -> bytes:
        """A message's payload; values may be vectors (N,) of float64, which take a sixth of the time of lists."""
        try:
            payload: bytes = self._packer.pack(fields)
        except TypeError:  # it contains vectors, or is invalid
            parts = [self._packer.pack_map_header(len(fields))]
            for name, value in fields.items():
                parts.append(self._packer.pack(name))
                if isinstance(value, np.ndarray):
                    parts += self._packer.pack_array_header(len(value)), _packed_vector(value)
                else:
                    parts.append(self._packer.pack(value))
            return b"".join(parts)
        return payload


def _packed_vector(numbers: FloatArray) -> memoryview:
    packed = np.empty(len(numbers), _NUMBER)
    packed["kind"], packed["value"] = _FLOAT64, numbers
    return packed.view(np.uint8).data  # `tobytes` would copy each number separately
