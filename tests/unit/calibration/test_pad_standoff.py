"""Height of the pads above the hinge line from two turned cylinders, against the emulated plant with all its errors."""

import math

import numpy as np
import pytest
from campaign import nightly
from off_pads import CONFIGURED, LIMITS, TRUE
from turned_cylinder import turned

from palmd.calibration.cylinder import CylinderError, turning_plan
from palmd.calibration.pad_scale import pad_scales
from palmd.calibration.pad_standoff import pad_standoffs
from palmd.calibration.standoff import proposed_settings, remarks
from palmd.config.two_palms import Config
from palmd.rig.imperfections import PERFECT, Imperfections, PadImperfection

RADII_M, MASSES_KG = (0.024, 0.012), (0.1, 0.025)
ANGLE_SD_RAD = math.radians(0.1)
OFF = Imperfections(
    (
        PadImperfection(scale=2e-3, sagitta=3e-5, standoff=3e-4, force=5e-5),
        PadImperfection(zero=-1e-4, sagitta=-2e-5, standoff=-1.5e-4, force=-3e-5),
    ),
    (math.radians(0.1), math.radians(-0.08)),
)


def heard(off=PERFECT, radii_m=RADII_M):
    return [
        turned(turning_plan(radius, LIMITS), LIMITS, TRUE, CONFIGURED, radius, mass, seed, imperfections=off)
        for seed, (radius, mass) in enumerate(zip(radii_m, MASSES_KG, strict=True))
    ]


@pytest.fixture(scope="module")
def off():
    return heard(OFF)


def test_standoffs_and_scales_are_separated_despite_all_other_errors(off):
    found = pad_standoffs(off, CONFIGURED, RADII_M, ANGLE_SD_RAD)
    for pad, true, configured in zip(found, OFF.pads, TRUE, strict=True):
        assert pad.standoff_sd_mm < 0.03
        assert pad.standoff_mm == pytest.approx(true.standoff * 1e3, abs=3.0 * pad.standoff_sd_mm)
        scale = pad.counts_per_mm / configured.counts_per_mm - 1.0
        assert scale == pytest.approx(true.scale, abs=3.0 * pad.scale_sd)
        assert pad.scale_sd < 0.003
        assert pad.noise_mm == pytest.approx(0.107, rel=0.05)
    alone, _ = pad_scales(
        off[0], CONFIGURED, RADII_M[0]
    )  # with one cylinder a standoff is not distinguishable from a scale error
    assert alone.counts_per_mm / TRUE[0].counts_per_mm - 1.0 > 0.005


@pytest.mark.parametrize("seed", [0, *nightly(1)])
def test_errors_match_their_sds(seed):
    random = np.random.default_rng(seed)
    radii = tuple(radius + 1e-5 * random.standard_normal() for radius in RADII_M)
    found = pad_standoffs(heard(radii_m=radii), CONFIGURED, RADII_M, ANGLE_SD_RAD)
    assert np.mean([(pad.standoff_mm / pad.standoff_sd_mm) ** 2 for pad in found]) < 4.0


def test_readings_of_other_cylinders_are_refused(off):
    with pytest.raises(CylinderError, match="was the plan stopped"):
        pad_standoffs([off[0], off[1][-3500:]], CONFIGURED, RADII_M, ANGLE_SD_RAD)


def test_remarks_say_how_to_move_a_pad(off):
    found = pad_standoffs(off, CONFIGURED, RADII_M, ANGLE_SD_RAD)
    config = Config.model_validate({"pads": {"palm1": {"port": "a"}, "palm2": {"port": "b"}}, "arm": {"port": "c"}})
    high, low = remarks(found, config)
    assert "above the hinge line, seen from the object: lower it by that" in high
    assert "below the hinge line, seen from the object: raise it by that" in low
    settings = proposed_settings(found)
    for i, pad in enumerate(found, 1):  # the standoff remains until the pad is shimmed
        assert settings[f"palm{i}"]["standoff_sd_mm"] >= abs(pad.standoff_mm)
