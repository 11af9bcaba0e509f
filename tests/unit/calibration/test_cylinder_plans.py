"""Plans that turn a cylinder: within limits and pads for any cylinder, otherwise refused with the reason."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from off_pads import LIMITS, share

from palmd.calibration.cylinder import PAD_MARGIN_M, SLOW_RAD_S, CylinderError, contact_m, tipping_plan, turning_plan
from palmd.config.two_palms import LimitsConfig, PlanSpec
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import compile_plan

CAUTIOUS = MotionLimits.from_config(LimitsConfig(rate_deg_s=10.0, acceleration_deg_s2=100.0), pad_length=0.0555)
NARROW = MotionLimits.from_config(LimitsConfig(phi1_deg=(20.0, 70.0), phi2_deg=(70.0, 110.0)), pad_length=0.0555)


def motion(plan, limits):
    trajectory = compile_plan(PlanSpec.model_validate(plan), limits)
    return [trajectory.at(t) for t in np.linspace(0.0, trajectory.duration, 5000)]


@pytest.mark.parametrize("limits", [LIMITS, CAUTIOUS, NARROW], ids=["usual", "cautious", "narrow"])
@pytest.mark.parametrize("radius_mm", [16.0, 20.0, 25.0, 30.0])
def test_contacts_move_slowly_over_the_pads_in_both_directions(radius_mm, limits):
    poses = motion(turning_plan(radius_mm * 1e-3, limits), limits)
    s = contact_m(radius_mm * 1e-3, np.array([pose.angles[1] for pose in poses]))
    assert s.min() > PAD_MARGIN_M - 1e-4
    assert s.max() < limits.pad_length - PAD_MARGIN_M + 1e-4
    assert np.ptp(s) > 0.010
    assert max(max(map(abs, pose.rates)) for pose in poses) < 1.001 * SLOW_RAD_S
    opening = [pose.rates[1] for pose in poses]
    assert min(opening) < -0.05 < 0.05 < max(opening)
    least = min(min(share(math.degrees(pose.angles[0]), math.degrees(pose.angles[1]))) for pose in poses[::50])
    assert least > 0.1, "both palms carry part of the weight"


@pytest.mark.parametrize("limits", [LIMITS, CAUTIOUS, NARROW], ids=["usual", "cautious", "narrow"])
@pytest.mark.parametrize("radius_mm", [12.0, 20.0, 30.0])
def test_every_rest_is_approached_from_both_sides_and_both_palms_carry_weight(radius_mm, limits):
    plan, rests = tipping_plan(radius_mm * 1e-3, limits, 2)
    motion(plan, limits)
    came = {}
    before = None
    for segment, after in itertools.pairwise([*plan["segments"], plan["segments"][0]]):
        if "move" not in segment:
            continue
        pose = (segment["move"]["phi1_deg"], segment["move"]["phi2_deg"])
        if "hold_s" in after:
            came.setdefault(pose, set()).add(math.copysign(1.0, pose[0] - before[0]))
            assert min(share(*pose)) > 0.15
            s = float(contact_m(radius_mm * 1e-3, np.radians(pose[1])))
            assert PAD_MARGIN_M - 1e-4 < s < limits.pad_length - PAD_MARGIN_M + 1e-4
        before = pose
    assert all(sides == {1.0, -1.0} for sides in came.values())
    assert rests == sum("hold_s" in segment for segment in plan["segments"]) == 32
    assert plan["repeat"] == 2


@pytest.mark.parametrize(
    ("radius_mm", "words"),
    [(2.0, "use a larger cylinder"), (80.0, "the radius is too large"), (300.0, "the radius is too large")],
)
def test_cylinders_that_cannot_be_moved_along_the_pads_are_refused(radius_mm, words):
    with pytest.raises(CylinderError, match=words):
        turning_plan(radius_mm * 1e-3, NARROW)


@pytest.mark.parametrize("radius_m", [0.074, 0.5])
def test_a_cylinder_that_would_nest_in_concave_palms_is_refused(radius_m):
    concave = replace(LIMITS, curvatures=(1 / 0.075, 1 / 0.075))
    with pytest.raises(CylinderError, match="nest in the concave palms, choose a smaller radius"):
        tipping_plan(radius_m, concave, 2)


def test_limits_that_prevent_tipping_the_palms_are_refused():
    upright = MotionLimits.from_config(LimitsConfig(phi1_deg=(40.0, 50.0)), pad_length=0.0555)
    with pytest.raises(
        CylinderError, match=r"at phi2 = 70° the limits allow phi1 a range of 8° only.*widen limits.phi1_deg"
    ):
        tipping_plan(0.02, upright, 2)
    with pytest.raises(CylinderError, match="radius is too large"):
        tipping_plan(0.3, LIMITS, 2)
