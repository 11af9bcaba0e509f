"""Plans become trajectories, or are refused with the segment, the value and the limit."""

from __future__ import annotations

import math
from typing import Any

import pytest

from palmd.config.two_palms import LimitsConfig, PlanSpec
from palmd.motion.kinematics import PoseError, RigGeometry
from palmd.motion.limits import MotionLimits, Workspace
from palmd.motion.plan import HOME, PlanError, PlanPlace, Trajectory, approach, compile_plan, home
from palmd.motion.segments import Move

LIMITS = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
GEOMETRY = RigGeometry(0.12, 0.0, 0.12, 0.12, -0.3, 0.0, 0.0)
HOME_MOVE = {"move": {"phi1_deg": 45, "phi2_deg": 90}, "duration_s": 2.0}


def plan(*segments: dict[str, Any], **rest: Any) -> PlanSpec:
    return PlanSpec.model_validate({"name": "test", "segments": list(segments), **rest})


def made(*segments: dict[str, Any], **rest: Any) -> Trajectory:
    return compile_plan(plan(*segments, **rest), LIMITS)


def refused(*segments: dict[str, Any], limits: MotionLimits = LIMITS, **rest: Any) -> list[str]:
    with pytest.raises(PlanError) as caught:
        compile_plan(plan(*segments, **rest), limits)
    return str(caught.value).splitlines()


def degrees(trajectory: Trajectory, tau: float) -> tuple[float, float]:
    motion = trajectory.at(tau)
    return math.degrees(motion.angles[0]), math.degrees(motion.angles[1])


def test_a_first_move_is_replaced_by_the_approach_in_the_first_round_only() -> None:
    trajectory = made(HOME_MOVE, {"rate": {"phi1_deg_s": 20}, "until": {"phi1_deg": 55}}, {"hold_s": 1.0}, repeat=3)
    assert (trajectory.start, trajectory.lead_in) == (HOME, 2.0)
    # 20°/s: ramps of 1.875·20/450 s; 10° at 20°/s and one ramp make 0.5 s + 83.3 ms.
    rate_s = 10 / 20 + 1.875 * 20 / 450
    assert trajectory.duration == pytest.approx(3 * (rate_s + 1.0) + 2 * 2.0)
    assert degrees(trajectory, rate_s) == pytest.approx((55, 90))
    assert degrees(trajectory, rate_s + 1.0 + 1.0) == pytest.approx((50, 90))  # halfway back
    assert degrees(trajectory, rate_s + 1.0 + 2.0) == pytest.approx((45, 90))
    assert degrees(trajectory, trajectory.duration) == pytest.approx((55, 90))
    assert degrees(trajectory, trajectory.duration + 10) == pytest.approx((55, 90))


def test_rate_segment_runs_at_its_rate_and_stops_at_until() -> None:
    trajectory = made(HOME_MOVE, {"rate": {"phi1_deg_s": -10, "phi2_deg_s": 4}, "until": {"phi2_deg": 94}})
    middle = trajectory.at(trajectory.duration / 2)
    assert (math.degrees(middle.rates[0]), math.degrees(middle.rates[1])) == pytest.approx((-10, 4))
    assert degrees(trajectory, trajectory.duration) == pytest.approx((35, 94))


def test_a_plan_of_a_single_move_consists_of_its_end() -> None:
    trajectory = made(HOME_MOVE)
    assert trajectory.duration == 0.0
    assert degrees(trajectory, 0.0) == pytest.approx((45, 90))
    assert trajectory.place(0.0).progress == 1.0


def test_rounds_without_a_first_move_continue_from_their_end() -> None:
    there_and_half_back = (
        {"rate": {"phi1_deg_s": 10, "phi2_deg_s": 1}, "until": {"phi1_deg": 55}},
        {"rate": {"phi1_deg_s": -10}, "until": {"phi1_deg": 45}},
    )
    trajectory = made(*there_and_half_back, repeat=4)
    assert degrees(trajectory, trajectory.duration) == pytest.approx((45, 94))
    for number in range(1, 4):
        joint = sum(done.duration for done in trajectory.rounds[:number])
        assert degrees(trajectory, joint - 1e-9) == pytest.approx(degrees(trajectory, joint + 1e-9), abs=1e-6)
    (message,) = refused(*there_and_half_back, repeat="forever")
    assert message.startswith("repeat: a plan cannot repeat forever when every round ends elsewhere")
    # φ2 leaves its limit of 155° in the course of 80 rounds.
    message = refused(*there_and_half_back, repeat=80)
    assert any("phi2 reaches" in each or "phi12 = phi1 + phi2" in each for each in message)


def test_a_plan_that_repeats_forever_is_endless_and_periodic() -> None:
    trajectory = made(
        HOME_MOVE, {"sine": {"phi1_deg": 18, "phi2_deg": 8}, "frequency_hz": 0.5, "duration_s": 10}, repeat="forever"
    )
    assert math.isinf(trajectory.duration)
    for tau in (11.0, 13.7, 20.0):
        assert degrees(trajectory, tau) == pytest.approx(degrees(trajectory, tau + 12.0 * 1000), abs=1e-6)
    assert trajectory.place(10.0 + 1.0).segment == 0
    assert trajectory.place(10.0 + 3.0).label == "sine"
    assert trajectory.place(10.0 + 6.0).progress == pytest.approx(0.5)


def test_place_gives_segment_and_progress() -> None:
    trajectory = made(HOME_MOVE, {"hold_s": 1.0}, {"hold_s": 3.0})
    place = trajectory.place(1.5)
    assert (place.segment, place.label, place.progress) == (2, "hold_s", pytest.approx(0.375))
    assert trajectory.place(4.0).progress == 1.0


def test_a_plan_without_a_move_starts_where_the_palms_stand() -> None:
    here = (math.radians(30), math.radians(100))
    trajectory = compile_plan(plan({"hold_s": 1.0}), LIMITS, here)
    assert (trajectory.start, trajectory.lead_in) == (here, 0.0)
    narrow = MotionLimits.from_config(LimitsConfig(phi1_deg=(50.0, 60.0)), pad_length=0.0555)
    assert home(narrow) == pytest.approx((math.radians(50), math.radians(90)))


def test_dither_is_added_to_the_whole_plan_and_begins_and_ends_at_rest() -> None:
    trajectory = made(HOME_MOVE, {"hold_s": 3.0}, dither={"amplitude_deg": 0.1, "frequency_hz": 10})
    for end in (0.0, 3.0):
        motion = trajectory.at(end)
        assert (motion.rates[0], motion.accelerations[1]) == pytest.approx((0, 0), abs=1e-9)
    # Crest of the 16th period: a quarter period after 1.5 s.
    assert degrees(trajectory, 1.525) == pytest.approx((45.1, 90.1))


@pytest.mark.parametrize(
    ("segment", "message"),
    [
        ({"move": {"phi1_deg": 163, "phi2_deg": 35}, "duration_s": 9}, "phi1 reaches 163°, the limit is 150°"),
        ({"move": {"phi1_deg": 3}, "duration_s": 9}, "phi1 falls to 3°, the limit is 6°"),
        ({"move": {"phi1_deg": 82}, "duration_s": 9}, "phi12 = phi1 + phi2 reaches 172°, it must stay below 172°"),
        (
            {"move": {"phi1_deg": 75}, "duration_s": 0.4},
            "the rate of phi1 reaches 140.625°/s, the limit is 120°/s; duration_s must be 0.47 or more",
        ),
        ({"move": {"phi1_deg": 55}, "duration_s": 0.25}, "the acceleration of phi1 reaches 923.7"),
        (
            {"rate": {"phi1_deg_s": 130}, "until": {"phi1_deg": 80.5}},
            "no room to speed up to 130°/s and slow down again",
        ),
        (
            {"rate": {"phi1_deg_s": -20}, "until": {"phi1_deg": 55}},
            "phi1 turns at -20°/s and never reaches 55°: it starts at 45°",
        ),
        ({"rate": {"phi1_deg_s": 20}, "until": {"phi2_deg": 95}}, "phi2 turns at 0°/s and never reaches 95°"),
        ({"rate": {"phi1_deg_s": 0.001}, "until": {"phi1_deg": 55}}, "takes 1e+04 s, more than 3600 s"),
        ({"sine": {"phi1_deg": 40}, "frequency_hz": 0.1, "duration_s": 60}, "phi1 falls to 5°, the limit is 6°"),
        ({"sine": {"phi2_deg": 20}, "frequency_hz": 1.2, "duration_s": 9}, "the acceleration of phi2 reaches 1263"),
        ({"sine": {"phi2_deg": 20}, "frequency_hz": 0.5, "duration_s": 0.2}, "the acceleration of phi2 reaches"),
    ],
)
def test_refusals_name_segment_value_and_limit(segment: dict[str, Any], message: str) -> None:
    lines = refused(HOME_MOVE, segment)
    assert any(line.startswith(f"segments.1: {message}") for line in lines), lines


def test_a_rate_above_the_limit_is_refused() -> None:
    corner = {"move": {"phi1_deg": 10, "phi2_deg": 40}, "duration_s": 2.0}
    made(corner, {"rate": {"phi2_deg_s": 119}, "until": {"phi2_deg": 120}})
    assert refused(corner, {"rate": {"phi2_deg_s": 121}, "until": {"phi2_deg": 120}}) == [
        "segments.1: the rate of phi2 reaches 121°/s, the limit is 120°/s"
    ]


def test_the_suggested_shortest_duration_is_accepted() -> None:
    for target in (50, 60, 75):
        (line, *_) = refused(HOME_MOVE, {"move": {"phi1_deg": target}, "duration_s": 0.02})
        shortest = float(line.split("duration_s must be ")[1].split()[0])
        made(HOME_MOVE, {"move": {"phi1_deg": target}, "duration_s": shortest})
        refused(HOME_MOVE, {"move": {"phi1_deg": target}, "duration_s": shortest - 0.02})


@pytest.mark.parametrize(
    ("segments", "lines"),
    [
        (
            [
                HOME_MOVE,
                {"rate": {"phi1_deg_s": 20}, "until": {"phi1_deg": 81}},
                {"rate": {"phi2_deg_s": 20}, "until": {"phi2_deg": 100}},
                {"hold_s": 5.0},
                {"move": {"phi1_deg": 45, "phi2_deg": 30}, "duration_s": 3},
            ],
            ["2: phi12 = phi1 + phi2 reaches 181°, it must stay below 172°", "4: phi2 falls to 30°, the limit is 35°"],
        ),
        (
            [HOME_MOVE, {"move": {"phi1_deg": 40, "phi2_deg": 160}, "duration_s": 9}],
            ["1: phi2 reaches 160°, the limit is 155°", "1: phi12 = phi1 + phi2 reaches 200°, it must stay below 172°"],
        ),
        (
            [{"move": {"phi1_deg": 160, "phi2_deg": 10}, "duration_s": 2}, {"hold_s": 1.0}],
            ["0: phi1 reaches 160°, the limit is 150°", "0: phi2 falls to 10°, the limit is 35°"],
        ),
    ],
    ids=["each at its segment", "direct before derived", "the first pose"],
)
def test_all_errors_are_reported_together(segments: list[dict[str, Any]], lines: list[str]) -> None:
    assert refused(*segments) == [f"segments.{line}" for line in lines]


def test_the_way_back_of_a_repetition_is_checked() -> None:
    far = {"rate": {"phi1_deg_s": 20}, "until": {"phi1_deg": 80}}
    quick_home = {"move": {"phi1_deg": 45, "phi2_deg": 90}, "duration_s": 0.4}
    made(quick_home, far)  # the approach takes the time that it needs
    rate, acceleration, *_ = refused(quick_home, far, repeat=2)
    assert rate.startswith("segments.0: the rate of phi1 reaches")
    assert acceleration.startswith("segments.0: the acceleration of phi1 reaches")


def test_dither_counts_against_the_limits() -> None:
    sine = {"sine": {"phi1_deg": 15}, "frequency_hz": 1.0, "duration_s": 10}  # 592°/s²
    made(HOME_MOVE, sine)
    (message,) = refused(HOME_MOVE, sine, dither={"amplitude_deg": 0.1, "frequency_hz": 10})  # 395°/s² more
    assert message.startswith("segments.1: the acceleration of phi1 reaches 10")
    lines = refused(HOME_MOVE, {"hold_s": 1.0}, dither={"amplitude_deg": 0.3, "frequency_hz": 10})
    assert lines[0].startswith("dither: takes 132% of the limit of the acceleration of phi1")


def test_the_arms_workspace_and_speed_are_limits_when_known() -> None:
    slow = Workspace(GEOMETRY, 0.0, 0.5, -0.3, 0.3, speed=0.05, acceleration=1.0)
    limits = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555, workspace=slow)
    lines = refused(HOME_MOVE, {"move": {"phi1_deg": 60}, "duration_s": 1.0}, limits=limits)
    assert lines[0].startswith("segments.1: the arm's speed reaches 83.3")
    assert "the limit is 50 mm/s; duration_s must be 1.67 or more" in lines[0]
    small = Workspace(GEOMETRY, 0.0, 0.26, -0.3, 0.3, speed=1.0, acceleration=10.0)
    limits = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555, workspace=small)
    (message,) = refused(HOME_MOVE, {"move": {"phi2_deg": 80}, "duration_s": 3.0}, limits=limits)
    assert message.startswith("segments.1: the arm's x reaches 26")


def test_an_exploration_begins_at_the_plans_end_and_is_endless() -> None:
    trajectory = made(HOME_MOVE, {"rate": {"phi1_deg_s": 20}, "until": {"phi1_deg": 55}}, {"explore": {}})
    assert trajectory.duration == math.inf
    begins = trajectory.rounds[0].begins[-1]
    assert trajectory.exploration(begins - 0.01) is None
    found = trajectory.exploration(begins + 2.0)
    assert found is not None
    exploration, t = found
    assert t == pytest.approx(2.0)
    assert degrees(trajectory, begins + 1e6) == pytest.approx((55, 90))
    exploration.append(Move(exploration.last.end, (math.radians(60), math.radians(95)), 1.0), t)
    assert degrees(trajectory, begins + 3.0) == pytest.approx((60, 95))
    exploration.coverage = 0.4
    assert trajectory.place(begins + 3.0) == PlanPlace(2, "explore", 0.4)
    assert trajectory.place(begins - 0.01).label == "rate"


def test_an_exploration_with_repeat_dither_or_later_segments_is_refused() -> None:
    lines = refused(
        HOME_MOVE, {"explore": {}}, {"hold_s": 1}, repeat="forever", dither={"amplitude_deg": 0.1, "frequency_hz": 10}
    )
    assert [line.split(":")[0] for line in lines] == ["dither", "repeat", "segments.1"]


def test_the_start_of_an_exploration_is_checked() -> None:
    with pytest.raises(PlanError, match=r"segments\.0: phi1 falls to 3°"):
        compile_plan(plan({"explore": {}}), LIMITS, (math.radians(3), math.radians(90)))


def test_the_approach_is_gentle_keeps_its_least_duration_and_the_limits() -> None:
    far = approach(HOME, (math.radians(75), math.radians(90)), LIMITS, 0.5)
    fastest = max(far.at(t).rates[0] for t in far.sample_times())
    assert math.degrees(fastest) == pytest.approx(30.0, rel=1e-3)  # a quarter of 120°/s
    assert approach(HOME, (0.8, 1.58), LIMITS, 4.0).duration == 4.0
    assert approach(HOME, HOME, LIMITS, 0.0).duration == 0.0
    with pytest.raises(PoseError, match="phi1 falls to 3°"):
        approach((math.radians(3), math.radians(90)), HOME, LIMITS, 0.0)
