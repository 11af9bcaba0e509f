"""How near calibrations with a cylinder come to the truth, over many emulated rigs."""

import numpy as np
import pytest
from benchtable import show
from turned_cylinder import turned

from palmd.calibration.cylinder import tipping_plan, turning_plan
from palmd.calibration.pad_force import pad_forces
from palmd.calibration.pad_scale import pad_scales
from palmd.config.pads import VersaPadConfig
from palmd.config.two_palms import LimitsConfig
from palmd.motion.limits import MotionLimits

pytestmark = [pytest.mark.bench, pytest.mark.timeout(300)]

TITLE, COLUMNS = "errors of both pads", ("rms", "largest", "rms in sd")
SEEDS = 12
ROUNDS = 8
RADIUS_M, MASS_KG = 0.02, 0.1
LIMITS = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
CONFIGURED = (VersaPadConfig(port="pad1"), VersaPadConfig(port="pad2"))
REAL = (
    VersaPadConfig(port="pad1", zero_mm=26.5, counts_per_mm=8.11, newtons_per_count=0.024),
    VersaPadConfig(port="pad2", zero_mm=29.2, counts_per_mm=7.65, newtons_per_count=0.017, sign=-1),
)


def heard(plan, seed):
    return turned(plan, LIMITS, REAL, CONFIGURED, RADIUS_M, MASS_KG, seed)


def row(what, errors, sd):
    """Root mean square and largest of the errors, and the first in the calibrations' own sd."""
    return (what, np.sqrt(np.mean(errors**2)), np.abs(errors).max(), np.sqrt(np.mean((errors / sd) ** 2)))


def test_zero_and_scale():
    plan = turning_plan(RADIUS_M, LIMITS)
    found = [pad_scales(heard(plan, seed), CONFIGURED, RADIUS_M) for seed in range(SEEDS)]
    pads = [(pad, real) for each in found for pad, real in zip(each, REAL, strict=True)]
    zero = np.array([pad.zero_mm - real.zero_mm for pad, real in pads])
    scale = np.array([pad.counts_per_mm / real.counts_per_mm - 1.0 for pad, real in pads]) * 100
    zero_sd = np.array([pad.zero_sd_mm for pad, _ in pads])
    scale_sd = np.array([pad.counts_per_mm_sd / real.counts_per_mm for pad, real in pads]) * 100
    show(TITLE, COLUMNS, [row("zero_mm, mm", zero, zero_sd), row("counts_per_mm, %", scale, scale_sd)])
    assert np.abs(zero).max() < 0.05
    assert np.abs(scale).max() < 0.3


def test_newtons_per_count():
    plan, rests = tipping_plan(RADIUS_M, LIMITS, ROUNDS)
    found = [
        pad_forces(heard(plan, seed), CONFIGURED, 9.81 * MASS_KG, rests, radius_m=RADIUS_M) for seed in range(SEEDS)
    ]
    pads = [(pad, real) for each in found for pad, real in zip(each.pads, REAL, strict=True)]
    gain = np.array([pad.newtons_per_count / real.newtons_per_count - 1.0 for pad, real in pads]) * 100
    sd = np.array([pad.newtons_per_count_sd / pad.newtons_per_count for pad, _ in pads]) * 100
    show(TITLE, COLUMNS, [row("newtons_per_count, %", gain, sd)])
    assert np.abs(gain).max() < 3.0
