"""How much of its limits a plan uses."""

from __future__ import annotations

import math

import pytest

from palmd.config.two_palms import LimitsConfig, PlanSpec
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import compile_plan
from palmd.motion.usage import sampled, usage

LIMITS = MotionLimits.from_config(LimitsConfig(rate_deg_s=100.0), pad_length=0.0555)
START = {"move": {"phi1_deg": 45, "phi2_deg": 90}, "duration_s": 2.0}


def plan(*segments: dict[str, object], repeat: int | str = 1):
    return compile_plan(
        PlanSpec.model_validate({"name": "x", "repeat": repeat, "segments": [START, *segments]}), LIMITS
    )


def test_limits_are_sorted_by_usage_and_printed_with_it() -> None:
    motion = sampled(plan({"move": {"phi1_deg": 25}, "duration_s": 0.5}))
    used = usage(motion, LIMITS)
    assert used == sorted(used, key=lambda each: -each.share)
    rate = next(each for each in used if each.bound.what == "the rate of phi1")
    assert rate.share == pytest.approx(15 / 8 * 20 / 0.5 / 100, rel=1e-3)  # a minimum-jerk move's peak
    assert rate.text() == "the rate of phi1 75 of 100°/s"
    still = next(each for each in used if each.bound.what == "the rate of phi2")
    assert still.share == 0.0
    pose = next(each for each in used if each.bound.what == "phi1")
    assert pose.share == pytest.approx((78 - 25) / 72)
    assert pose.text() == "phi1 25 to 45 of 6 to 150°"


@pytest.mark.parametrize(
    ("segment", "repeat", "seconds", "whole"),
    [
        ({"hold_s": 1.0}, 1, 1.0, True),
        ({"hold_s": 1.0}, "forever", 4.0, False),  # two rounds; the first needs no way to its start
        ({"hold_s": 600.0}, 1, 120.0, False),
        ({"explore": {}}, 1, 0.0, False),
    ],
)
def test_endless_plans_are_sampled_for_a_limited_time(segment, repeat, seconds: float, whole: bool) -> None:
    motion = sampled(plan(segment, repeat=repeat))
    assert motion.t[-1] == pytest.approx(seconds)
    assert motion.whole is whole
    assert motion.angles[0] == pytest.approx([math.radians(45), math.radians(90)])
