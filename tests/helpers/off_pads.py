"""Pads that differ from their configuration, and the errors a calibration leaves."""

import math

import numpy as np

from palmd.config.pads import VersaPadConfig
from palmd.config.two_palms import LimitsConfig
from palmd.motion.limits import MotionLimits

LIMITS = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
CONFIGURED = tuple(VersaPadConfig(port=f"pad{number}") for number in (1, 2))
TRUE = (
    CONFIGURED[0].model_copy(update={"zero_mm": 26.5, "counts_per_mm": 8.11, "newtons_per_count": 0.024}),
    CONFIGURED[1].model_copy(update={"zero_mm": 29.2, "counts_per_mm": 7.65, "newtons_per_count": 0.017, "sign": -1}),
)
"""Errors of 1.5 mm, 3 % and 20 %; one pad is mirrored."""


def errors(found, true=TRUE):
    """Errors of a pair of PadScale: zero (mm) and counts_per_mm (relative), pad after pad."""
    return [
        (each.zero_mm - pad.zero_mm, each.counts_per_mm / pad.counts_per_mm - 1.0)
        for each, pad in zip(found, true, strict=True)
    ]


def gain_errors(found, true=TRUE):
    """Relative errors of both pads' newtons_per_count."""
    pads = zip(found.pads, true, strict=True)
    return [each.newtons_per_count / pad.newtons_per_count - 1.0 for each, pad in pads]


def share(phi1_deg, phi2_deg):
    """N1 and N2 for a weight of 1 without friction, from the balance of forces."""
    phi1, phi12 = math.radians(phi1_deg), math.radians(phi1_deg + phi2_deg)
    normals = np.array([[-math.sin(phi1), math.sin(phi12)], [math.cos(phi1), -math.cos(phi12)]])
    return np.linalg.solve(normals, [0.0, 1.0])
