"""Zero, scale and sign of both pads from a turned cylinder: against the emulated plant, and with invalid readings."""

import math

import numpy as np
import pytest
from off_pads import CONFIGURED, LIMITS, TRUE, errors
from turned_cylinder import turned

from palmd.calibration.cylinder import CylinderError, contact_m, turning_plan
from palmd.calibration.pad_scale import pad_scales
from palmd.config.pads import VersaPadConfig
from palmd.devices.pad import counts_to_mm
from palmd.events import PadSample, PalmSample
from palmd.rig.pads import PadOptions

RADIUS_M, MASS_KG = 0.02, 0.1
PLAN = turning_plan(RADIUS_M, LIMITS)


def heard(seed=1, **more):
    return turned(PLAN, LIMITS, TRUE, CONFIGURED, RADIUS_M, MASS_KG, seed, **more)


@pytest.fixture(scope="module")
def events():
    return heard()


def on_pad(events, number, change):
    """Change the readings of one pad; None removes a reading."""
    changed = [change(event) if isinstance(event, PadSample) and event.pad == number else event for event in events]
    return [event for event in changed if event is not None]


def refused(events, configs=CONFIGURED):
    with pytest.raises(CylinderError) as caught:
        pad_scales(events, configs, RADIUS_M)
    return str(caught.value)


@pytest.mark.parametrize("phi2_deg", [35.0, 90.0, 150.0])
def test_contacts_of_a_circle_with_two_lines(phi2_deg):
    phi1, phi2 = 0.3, math.radians(phi2_deg)
    # the centre is at the distance R from both lines; the contact is the foot of its perpendicular
    normals = np.array([(-math.sin(phi1), math.cos(phi1)), (math.sin(phi1 + phi2), -math.cos(phi1 + phi2))])
    centre = np.linalg.solve(normals, [0.02, 0.02])
    feet = [centre @ (math.cos(a), math.sin(a)) for a in (phi1, phi1 + phi2)]
    assert contact_m(0.02, np.array([phi2])) == pytest.approx(feet[0], abs=1e-12)
    assert feet[1] == pytest.approx(feet[0], abs=1e-12)


def test_errors_are_found_within_their_sd_and_the_stated_tolerance(events):
    found = pad_scales(events, CONFIGURED, RADIUS_M)
    assert [pad.sign for pad in found] == [1, -1]
    for pad, true, (zero_mm, scale) in zip(found, TRUE, errors(found), strict=True):
        assert abs(zero_mm) < min(0.05, 4.0 * pad.zero_sd_mm)
        assert abs(scale) < min(0.003, 4.0 * pad.counts_per_mm_sd / true.counts_per_mm)
        assert pad.noise_mm == pytest.approx(0.107, rel=0.05)  # 0.1 mm noise, and rounding to 0.127 mm
        assert pad.bend_mm < 0.03
        assert (pad.low_mm, pad.high_mm) == pytest.approx((5.0, 50.5), abs=0.1)


def test_a_pads_latency_does_not_bias_the_result():
    assert np.abs(errors(pad_scales(heard(late_s=0.01), CONFIGURED, RADIUS_M))).max() < 0.01


def test_a_wrong_radius_gives_a_wrong_scale_of_both_pads(events):
    for (zero_mm, scale), true in zip(errors(pad_scales(events, CONFIGURED, 1.01 * RADIUS_M)), TRUE, strict=True):
        assert scale == pytest.approx(-0.01, abs=1e-3)
        assert zero_mm == pytest.approx(0.01 * true.zero_mm, abs=0.01)


def test_a_bend_of_one_pad_is_attributed_to_that_pad():
    bowed = pad_scales(heard(bend_m=(0.0, 4e-4)), CONFIGURED, RADIUS_M)
    assert bowed[0].bend_mm < 0.03
    assert bowed[1].bend_mm > 0.1 > 10 * bowed[1].bend_sd_mm


def test_an_error_of_the_arm_appears_as_a_bend_of_both_pads():
    found = pad_scales(heard(phi2_error_rad=math.radians(1.0)), CONFIGURED, RADIUS_M)
    assert min(pad.bend_mm for pad in found) > 0.1


def test_a_few_outliers_do_not_change_the_result(events):
    rng = np.random.default_rng(5)

    def spoil(event):
        if rng.uniform() > 0.02:
            return event
        s_mm = CONFIGURED[0].zero_mm + float(rng.integers(-200, 200)) / CONFIGURED[0].counts_per_mm
        return PadSample(event.t_sample, 1, s_mm * 1e-3, event.force)

    clean, _ = pad_scales(events, CONFIGURED, RADIUS_M)
    corrupted, _ = pad_scales(on_pad(events, 1, spoil), CONFIGURED, RADIUS_M)
    assert corrupted.spoilt > 80
    assert corrupted.zero_mm == pytest.approx(clean.zero_mm, abs=0.005)
    assert corrupted.counts_per_mm == pytest.approx(clean.counts_per_mm, rel=5e-4)


def test_readings_made_with_another_configuration_are_refused(events):
    other = CONFIGURED[0].model_copy(update={"zero_mm": 26.5})
    assert "pad 1's readings were made with another configuration" in refused(events, (other, CONFIGURED[1]))
    other = CONFIGURED[1].model_copy(update={"newtons_per_count": 0.017})
    assert "pad 2's readings were made with another configuration" in refused(events, (CONFIGURED[0], other))


def test_a_pad_that_does_not_follow_the_cylinder_is_refused(events):
    across = [PadSample(e.t_sample, 2, 0.028, e.force) if isinstance(e, PadSample) and e.pad == 2 else e
              for e in events]  # fmt: skip
    assert "pad 2's counts do not follow the cylinder (from 0 to 0 over 46 mm of travel)" in refused(across)


def test_insufficient_readings_are_refused(events):
    assert "pad 1: 0 readings" in refused([])
    assert "pad 1: 0 readings" in refused([event for event in events if not isinstance(event, PalmSample)])
    assert "on both palms" in refused(on_pad(events, 2, lambda _: None))
    assert "on both palms" in refused(events[:1000])
    assert "was the plan stopped?" in refused(events[-3500:])


def test_a_noise_free_pad_with_repeated_counts_is_calibrated():
    found = pad_scales(heard(pad_options=PadOptions(noise_m=0.0)), CONFIGURED, RADIUS_M)
    assert np.abs(errors(found)).max() < 0.01


BENDS_M = (6e-4, -3e-4)


@pytest.fixture(scope="module")
def bent():
    return heard(bend_m=BENDS_M)


def test_the_fitted_curve_corrects_bent_readings(bent):
    found = pad_scales(bent, CONFIGURED, RADIUS_M, curved=True)
    for pad, true, bend_m in zip(found, TRUE, BENDS_M, strict=True):
        curved = true.model_copy(
            update={"zero_mm": pad.zero_mm, "counts_per_mm": pad.counts_per_mm, "curve_mm": pad.curve_mm}
        )
        for s_mm in np.linspace(6.0, 50.0, 23):
            said_mm = s_mm + bend_m * 1e3 * math.sin(math.pi * s_mm / true.length_mm)
            counts = true.sign * (said_mm - true.zero_mm) * true.counts_per_mm
            assert counts_to_mm(curved, counts) == pytest.approx(s_mm, abs=0.04)
        assert pad.bend_mm < 0.03
        assert pad.noise_mm == pytest.approx(0.107, rel=0.05)
    assert max(pad.bend_mm for pad in pad_scales(bent, CONFIGURED, RADIUS_M)) > 0.15


def test_a_configured_curve_is_applied_and_can_be_refitted(bent):
    first = pad_scales(bent, CONFIGURED, RADIUS_M, curved=True)
    configured = tuple(
        config.model_copy(update={
            "zero_mm": pad.zero_mm, "counts_per_mm": pad.counts_per_mm, "sign": pad.sign, "curve_mm": pad.curve_mm
        })
        for config, pad in zip(CONFIGURED, first, strict=True)
    )  # fmt: skip
    again = turned(PLAN, LIMITS, TRUE, configured, RADIUS_M, MASS_KG, 1, bend_m=BENDS_M)
    straight, refitted = (pad_scales(again, configured, RADIUS_M, curved=curved) for curved in (False, True))
    for was, now, new in zip(first, straight, refitted, strict=True):
        assert now.bend_mm < 0.03
        assert now.zero_mm == pytest.approx(was.zero_mm, abs=0.01)
        assert now.counts_per_mm == pytest.approx(was.counts_per_mm, rel=1e-3)
        assert new.curve_mm == pytest.approx(was.curve_mm, abs=0.02)


@pytest.mark.parametrize("curve_mm", [[0.1], [0.0, 20.0], [0.0, math.nan]])
def test_invalid_curves_are_refused(curve_mm):
    with pytest.raises(ValueError, match="curve_mm"):
        VersaPadConfig(port="pad1", curve_mm=curve_mm)
