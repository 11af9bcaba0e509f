"""A message's bytes, as whoever needs no more of palmd reads them."""

from __future__ import annotations

from typing import Any

import msgpack

FRAMES = (3, 2)
"""How many frames a message may have: topic, payload and the time it was sent; a publisher may leave out the last."""


def unpacked(payload: bytes) -> dict[str, Any] | None:
    """The msgpack map in a payload; None for anything else."""
    try:
        fields = msgpack.unpackb(payload)
    except Exception:  # msgpack raises half a dozen kinds for bytes that are not its own
        return None
    return fields if isinstance(fields, dict) else None
