"""Both palms' curvature from a turned cylinder: against the geometry of circles, and with invalid readings."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palmd.calibration.curvature import proposed_settings, remarks, table
from palmd.calibration.cylinder import CylinderError, contacts_m, turning_plan
from palmd.calibration.pad_curvature import pad_curvatures
from palmd.calibration.pad_scale import pad_scales
from palmd.config.pads import VersaPadConfig
from palmd.config.two_palms import LimitsConfig
from palmd.events import PadSample, PalmSample
from palmd.motion.limits import MotionLimits
from palmd.rig.world import default_config
from palmd.system.arcs import opening_at

RADIUS_M = 0.02
CONFIGS = (VersaPadConfig(port="one"), VersaPadConfig(port="two"))
LIMITS = LimitsConfig(phi1_deg=(0.0, 110.0), phi2_deg=(60.0, 160.0))


def places(radius: float, phi2: float, curvatures: tuple[float, float]) -> tuple[float, float]:
    """Contacts of a disc with two arcs through the hinge; its centre is R − r (cradle) or R + r (dome) from theirs."""
    centres = [(0.0, 1.0 / curvatures[0]), (math.sin(phi2) / curvatures[1], -math.cos(phi2) / curvatures[1])]
    away = [abs(1.0 / kappa - radius) for kappa in curvatures]
    (x1, y1), (x2, y2) = centres
    apart = math.hypot(x2 - x1, y2 - y1)
    along = (apart**2 + away[0] ** 2 - away[1] ** 2) / (2 * apart)
    across = math.sqrt(away[0] ** 2 - along**2)
    ux, uy = (x2 - x1) / apart, (y2 - y1) / apart
    both = [(x1 + along * ux - side * across * uy, y1 + along * uy + side * across * ux) for side in (1, -1)]

    def s_of(x: float, y: float) -> tuple[float, float]:
        found = []
        for (cx, cy), kappa, start in zip(centres, curvatures, (-math.pi / 2, phi2 + math.pi / 2), strict=True):
            turn = math.atan2(y - cy, x - cx) - (start if kappa > 0 else start + math.pi)
            turn = (turn + math.pi) % math.tau - math.pi
            found.append(turn * (1 if not found else -1) / kappa)
        return found[0], found[1]

    return min(s for s in (s_of(*at) for at in both) if s[0] > 0 and s[1] > 0)  # the other intersection is farther out


def heard(curvatures, zeros_mm=(0.0, 0.0), scale=(1.0, 1.0), seed=1, n=1500):
    """What a daemon whose configuration assumes correct pads passes to its observer."""
    random = np.random.default_rng(seed)
    low, high = (opening_at(RADIUS_M, s, curvatures) for s in (0.045, 0.012))
    events = []
    for k in range(n):
        t = 0.01 * k
        phi2 = low + (high - low) * (1 - math.cos(math.tau * k / n)) / 2
        s = places(RADIUS_M, phi2, curvatures)
        events.append(PalmSample(t, (0.6, phi2 + random.normal(0, 1.5e-4)), (0.0, 0.1), (0.0, 0.0)))
        for number, config in enumerate(CONFIGS, 1):
            mm = s[number - 1] * 1e3 + random.normal(0, 0.1) - zeros_mm[number - 1]
            counts = round(config.sign * config.counts_per_mm * scale[number - 1] * mm)
            position_mm = config.zero_mm + config.sign * counts / config.counts_per_mm
            events.append(PadSample(t + 2e-3, number, position_mm * 1e-3, 1.0))
    return events


@pytest.mark.parametrize("curvatures", [(13.3, 13.3), (16.0, 11.5), (-8.0, -11.0), (14.0, -9.0)])
def test_curvatures_and_zeros_are_found_within_their_sd(curvatures):
    found = pad_curvatures(
        heard(curvatures, zeros_mm=(0.4, -0.3)), CONFIGS, RADIUS_M, [0.8 * each for each in curvatures]
    )
    for palm, kappa, zero in zip(found, curvatures, (0.4, -0.3), strict=True):
        assert abs(palm.curvature_per_m - kappa) < 4 * palm.curvature_sd_per_m
        assert abs(palm.curvature_per_m - kappa) < 0.1
        assert palm.curvature_sd_per_m < 0.4  # mostly from the scale
        assert palm.zero_mm == pytest.approx(zero, abs=0.1)
        assert palm.noise_mm == pytest.approx(0.107, rel=0.1)


def test_the_sd_covers_an_error_of_the_scale():
    curvatures = (13.3, 13.3)
    off = pad_curvatures(heard(curvatures, scale=(1.003, 1.0)), CONFIGS, RADIUS_M, curvatures)[0]
    assert 0.02 < abs(off.curvature_per_m - curvatures[0]) < 3 * off.curvature_sd_per_m


def test_contacts_follow_circle_geometry_and_scales_are_found_on_arcs():
    curvatures = (16.0, 11.5)
    phi2 = np.array([1.7, 2.0, 2.3])
    wanted = np.array([places(RADIUS_M, each, curvatures) for each in phi2]).T
    assert contacts_m(RADIUS_M, phi2, curvatures) == pytest.approx(wanted, abs=1e-10)
    found = pad_scales(heard(curvatures, zeros_mm=(0.4, -0.3), scale=(1.01, 0.99)), CONFIGS, RADIUS_M, curvatures)
    for pad, config, zero, scale in zip(found, CONFIGS, (0.4, -0.3), (1.01, 0.99), strict=True):
        assert pad.zero_mm == pytest.approx(zero, abs=0.03)
        assert pad.counts_per_mm == pytest.approx(scale * config.counts_per_mm, rel=1e-3)


def test_the_plan_keeps_the_cylinder_on_the_pads_of_a_cradle():
    limits = MotionLimits.from_config(LIMITS, pad_length=0.0555, curvatures=(13.3, 13.3))
    plan = turning_plan(RADIUS_M, limits)
    phi2 = np.radians([each["move"]["phi2_deg"] for each in plan["segments"] if "move" in each])
    s = contacts_m(RADIUS_M, phi2, limits.curvatures)
    assert s.min() > 0.0045
    assert s.max() < 0.0511
    assert np.ptp(s) > 0.02


def test_counts_that_do_not_follow_the_cylinder_are_refused():
    events = [each if not isinstance(each, PadSample) else PadSample(each.t_sample, each.pad, 0.02, 1.0)
              for each in heard((13.3, 13.3), n=1200)]  # fmt: skip
    with pytest.raises(CylinderError, match=r"counts|arcs|configuration"):
        pad_curvatures(events, CONFIGS, RADIUS_M, (13.3, 13.3))


def test_table_settings_and_remarks_of_a_result():
    found = pad_curvatures(heard((13.3, 12.0), zeros_mm=(0.5, 0.0)), CONFIGS, RADIUS_M, (13.0, 13.0))
    printed = table(found)
    assert "palm 1: " in printed
    assert "mm concave" in printed
    assert set(proposed_settings(found)) == {"palm1_curvature_per_m", "palm2_curvature_per_m"}
    assert any("pad 1's zero has an error of" in each for each in remarks(found, default_config()))
