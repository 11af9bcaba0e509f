"""A smoother's answer for tests; fields not given are zero."""

from __future__ import annotations

from typing import Any

import numpy as np

from palmd.events import FloatArray, Improvement
from palmd.model.smoothing import RIG_CONSTANTS
from palmd.observer.coverage import NORMAL_BINS


def improvement(x: FloatArray, P: FloatArray, **fields: Any) -> Improvement:
    """Improvement with state `x` and covariance `P`; further fields by name."""
    nothing = np.zeros(RIG_CONSTANTS)
    rest: dict[str, Any] = {
        "t": 1.0,
        "frame": 1,
        "established": True,
        "touched": np.zeros(NORMAL_BINS, dtype=np.bool_),
        "rig": nothing,
        "rig_sd": nothing,
        "spread": np.zeros((len(x) + RIG_CONSTANTS, RIG_CONSTANTS)),
        "contradicted": nothing,
    }
    return Improvement(x=x, P=P, **(rest | fields))
