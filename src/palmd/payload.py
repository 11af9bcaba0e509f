"""Decoding of messages, for programs that need nothing else of palmd."""

from __future__ import annotations

from typing import Any

import msgpack

FRAMES = (3, 2)
"""Number of frames of a message: topic, payload and time of sending; a publisher may omit the last."""


def unpacked(payload: bytes) -> dict[str, Any] | None:
    """The msgpack map in a payload; None for anything else."""
    try:
        fields = msgpack.unpackb(payload)
    except Exception:  # msgpack raises many kinds of exceptions for invalid data
        return None
    return fields if isinstance(fields, dict) else None
