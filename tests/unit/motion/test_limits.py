"""Motion limits in degrees and millimetres, and the clamp before each set-point."""

from __future__ import annotations

import math

import pytest
from palms import motion_of

from palmd.config.two_palms import LimitsConfig
from palmd.events import PalmMotion
from palmd.motion.kinematics import RigGeometry
from palmd.motion.limits import SMALL_RADIUS, MotionLimits, Workspace
from palmd.system.arcs import circle_radius

LIMITS = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
GEOMETRY = RigGeometry(0.12, 0.0, 0.12, 0.12, -0.3, 0.0, 0.0)


def rad(*degrees: float) -> tuple[float, ...]:
    return tuple(map(math.radians, degrees))


@pytest.mark.parametrize(
    ("phi1_deg", "phi2_deg", "message"),
    [
        (45, 90, []),
        (6, 35, []),
        (5, 90, ["phi1 falls to 5°, the limit is 6°"]),
        (
            163,
            35,
            ["phi1 reaches 163°, the limit is 150°", "phi12 = phi1 + phi2 reaches 198°, it must stay below 172°"],
        ),
        (
            20,
            156,
            ["phi2 reaches 156°, the limit is 155°", "phi12 = phi1 + phi2 reaches 176°, it must stay below 172°"],
        ),
        (82, 90, ["phi12 = phi1 + phi2 reaches 172°, it must stay below 172°"]),
        (81.99, 90, []),
        (45, 34.5, ["phi2 falls to 34.5°, the limit is 35°"]),
    ],
)
def test_violations_name_value_and_limit(phi1_deg: float, phi2_deg: float, message: list[str]) -> None:
    assert LIMITS.violations(tuple(rad(phi1_deg, phi2_deg))) == message


@pytest.mark.parametrize("kappa", [13.3, -10.0])
def test_on_curved_palms_the_tangents_at_the_contacts_are_limited(kappa: float) -> None:
    limits = MotionLimits.from_config(
        LimitsConfig(phi1_deg=(0.0, 150.0), phi2_deg=(5.0, 175.0)), pad_length=0.0555, curvatures=(kappa, kappa)
    )
    first, opening, total = limits.bounds[:3]
    joints = ((math.pi - opening.low) / 2, opening.low)
    at_the_end = circle_radius(joints, (0.0535, 0.0535), (kappa, kappa))
    if kappa > 0:
        assert at_the_end == pytest.approx(SMALL_RADIUS, rel=1e-9), "no small object leaves the pads"
    else:
        assert opening.low == pytest.approx(math.radians(5.0)), "domes diverge by themselves"
        assert at_the_end > SMALL_RADIUS
    steepest = -min(kappa, 0.0) * 0.0555
    assert first.low == pytest.approx(steepest), "or palm 1's end points down"
    steepest_contact = total.high - kappa * (0.3 if kappa > 0 else 1.0) * 0.0555  # palm 2's tangent there
    assert steepest_contact == pytest.approx(math.radians(172.0), abs=1e-6)
    too_far = PalmMotion.at_rest((total.high - 1.4, 1.5))
    assert limits.clamp_step(PalmMotion.at_rest((1.0, 1.5)), too_far, 10.0).angles[1] < 1.5


def test_nan_violates_the_limits() -> None:
    assert LIMITS.violations((math.nan, 1.5))


def test_angles_at_which_even_a_small_object_leaves_the_pads_are_violations() -> None:
    # r/tan(φ2/2) = 53.5 mm for r = 10 mm at φ2 = 21.2°; this matters only with wider limits
    wide = MotionLimits.from_config(LimitsConfig(phi2_deg=(5.0, 155.0)), pad_length=0.0555)
    assert wide.violations(tuple(rad(45, 22))) == []
    assert wide.violations(tuple(rad(45, 20))) == [
        "phi2 falls to 20°, even an object of 10 mm radius leaves the pads below 21.1746°"
    ]


def test_the_arms_workspace_is_a_limit() -> None:
    workspace = Workspace(GEOMETRY, 0.1, 0.26, -0.2, 0.2, 0.5, 5.0)
    limits = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555, workspace=workspace)
    assert limits.violations(tuple(rad(45, 90))) == []  # x = 250.3 mm
    (message,) = limits.violations(tuple(rad(45, 80)))
    assert message.startswith("the arm's x reaches 26")
    assert message.endswith(", the limit is 260 mm")


def test_clamp_leaves_an_allowed_step_unchanged() -> None:
    wanted = motion_of(rad(45.5, 90.5, 50, 50, 3, 4))
    assert LIMITS.clamp_step(motion_of(rad(45, 90)), wanted, 0.016) is wanted


def test_clamp_shortens_a_long_step_along_its_direction() -> None:
    sent = LIMITS.clamp_step(motion_of(rad(45, 90)), motion_of(rad(55, 85)), 0.016)
    # 120°/s for 16 ms is 1.92° for the longer of the two.
    assert sent.angles == pytest.approx(rad(46.92, 89.04))
    assert sent.rates == pytest.approx(rad(120, -60))


def test_clamp_keeps_the_sum_below_its_bound_and_stands_still_for_nan() -> None:
    near = motion_of(rad(81, 90.5))
    sent = LIMITS.clamp_step(near, motion_of(rad(82, 91)), 0.016)
    assert math.degrees(sent.angles[0] + sent.angles[1]) <= 172.0
    assert not LIMITS.violations(sent.angles)
    assert LIMITS.clamp_step(near, PalmMotion.at_rest((math.nan, 1.0)), 0.016) == PalmMotion.at_rest(near.angles)


def test_clamp_returns_from_outside_at_the_rate_limit() -> None:
    outside = motion_of(rad(170, 90))
    sent = LIMITS.clamp_step(outside, motion_of(rad(45, 90)), 0.016)
    assert math.degrees(outside.angles[0] - sent.angles[0]) == pytest.approx(1.92)


def test_palm_2s_direction_has_the_gain_of_both_angles() -> None:
    """A dither of both angles takes twice as much of this bound as of each angle's."""
    (both,) = (bound for bound in LIMITS.bounds if bound.what == "phi12 = phi1 + phi2")
    before, after = (LIMITS.values(PalmMotion.at_rest(rad(*angles)))[2] for angles in ((45, 90), (46, 91)))
    assert both.gain == pytest.approx((after - before) / math.radians(1.0))


def test_a_cradle_may_point_downwards_at_its_hinge_like_its_mirror_image() -> None:
    """φ1 for π − φ12: the range of palm 1 between two cradles, which flat palms do not have."""
    kappa, open_wide = 13.3, LimitsConfig(phi1_deg=(-30.0, 150.0), phi2_deg=(5.0, 175.0))
    for each in (kappa, 0.0):
        lowest = MotionLimits.from_config(open_wide, pad_length=0.0555, curvatures=(each, each)).bounds[0].low
        assert lowest == pytest.approx(-0.3 * 0.0555 * each)
    cradle = MotionLimits.from_config(open_wide, pad_length=0.0555, curvatures=(kappa, kappa))
    assert cradle.violations(rad(-12, 120)) == []
    (message,) = cradle.violations(rad(-14, 120))
    assert message.startswith("phi1 falls to -14°, palm 1 points downwards below -12.6")
    assert math.pi - cradle.top == pytest.approx(cradle.bounds[0].low + math.radians(8.0))


@pytest.mark.parametrize(("kappa", "share"), [(13.3, 0.3), (0.5, 0.3), (-0.5, 1.0), (-4.0, 1.0)])
def test_each_palm_is_limited_by_its_own_curvature(kappa: float, share: float) -> None:
    """φ12 by palm 2's curvature, φ1 by palm 1's: a slight cradle or a dome beside a flat palm."""
    open_wide = LimitsConfig(phi1_deg=(-30.0, 150.0), phi2_deg=(5.0, 175.0))
    turned = share * 0.0555 * kappa
    first, second = (
        MotionLimits.from_config(open_wide, pad_length=0.0555, curvatures=each) for each in ((kappa, 0.0), (0.0, kappa))
    )
    assert (first.bounds[0].low, first.top) == pytest.approx((-turned, math.radians(172.0)))
    assert (second.bounds[0].low, second.top) == pytest.approx((0.0, math.radians(172.0) + turned))


def test_a_flat_palm_pointing_downwards_is_named_unless_its_own_limit_excludes_it() -> None:
    wide, level = (
        MotionLimits.from_config(LimitsConfig(phi1_deg=(low, 150.0)), pad_length=0.0555, curvatures=(0.0, 0.0))
        for low in (-30.0, 0.0)
    )
    (message,) = wide.violations(rad(-5, 120))
    assert message.startswith("phi1 falls to -5°, palm 1 points downwards below")
    (message,) = level.violations(rad(-5, 120))
    assert message.startswith("phi1 falls to -5°")
    assert "downwards" not in message


def test_a_dome_that_would_point_downwards_is_named() -> None:
    dome = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555, curvatures=(-4.0, 0.0))
    (message,) = dome.violations(rad(8, 90))
    assert message.startswith("phi1 falls to 8°, palm 1 is a dome")
