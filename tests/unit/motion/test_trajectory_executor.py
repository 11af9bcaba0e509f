"""The trajectory executor: hold and resume on the path, gentle starts, no jump after a late call."""

from __future__ import annotations

import math
from typing import Any

import pytest

from palmd.config.two_palms import LimitsConfig, PlanSpec
from palmd.events import PalmMotion
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import HOME, Trajectory, compile_plan
from palmd.motion.segments import Move
from palmd.motion.trajectory_executor import LONGEST_STEP, MotionError, TrajectoryExecutor

LIMITS = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
DT = 0.016
SWING = {"sine": {"phi1_deg": 20, "phi2_deg": 10}, "frequency_hz": [0.6, 0.4], "duration_s": 8}


def plan(*segments: dict[str, Any], **rest: Any) -> Trajectory:
    return compile_plan(PlanSpec.model_validate({"name": "test", "segments": list(segments), **rest}), LIMITS)


class Run:
    """An executor with a regular clock that records its commands."""

    def __init__(self, trajectory: Trajectory | None = None) -> None:
        self.executor = TrajectoryExecutor(LIMITS)
        self.executor.stand(HOME)
        self.t = 100.0
        self.motions = [self.executor.advance(self.t)]
        if trajectory is not None:
            self.executor.start(trajectory)

    def go(self, seconds: float) -> PalmMotion:
        for _ in range(round(seconds / DT)):
            self.t += DT
            self.motions.append(self.executor.advance(self.t))
        return self.motions[-1]


def angles(motion: PalmMotion) -> tuple[float, float]:
    return motion.angles


def at_rest(motion: PalmMotion) -> bool:
    return motion.rates[0] == motion.rates[1] == motion.accelerations[0] == motion.accelerations[1] == 0.0


def test_it_stands_still_until_started() -> None:
    run = Run()
    assert run.go(1.0) == PalmMotion.at_rest(HOME)
    assert not run.executor.moving
    assert run.executor.place is None


def test_it_runs_a_plan_in_real_time_and_is_done_at_its_end() -> None:
    trajectory = plan(SWING)
    run = Run(trajectory)
    run.go(3.2)
    assert angles(run.motions[-1]) == pytest.approx(angles(trajectory.at(run.t - 100.0)), abs=1e-9)
    assert run.executor.moving
    run.go(5.0)
    assert run.executor.done
    assert not run.executor.moving
    assert at_rest(run.motions[-1])
    assert run.executor.place is not None
    assert run.executor.place.progress == 1.0


def test_it_approaches_the_plans_start_in_the_first_moves_duration() -> None:
    trajectory = plan({"move": {"phi1_deg": 50, "phi2_deg": 85}, "duration_s": 3.0}, {"hold_s": 1.0})
    run = Run(trajectory)
    middle = run.go(1.504)
    assert math.degrees(middle.angles[0]) == pytest.approx(47.5, abs=0.1)
    assert run.executor.place is not None
    assert run.executor.place.label == "approach"
    run.go(1.6)
    assert run.executor.place.label == "hold_s"
    assert math.degrees(run.motions[-1].angles[0]) == pytest.approx(50)


def test_hold_stops_on_the_path_and_resume_continues_there() -> None:
    trajectory = plan(SWING)
    free = [trajectory.at(i * 0.001) for i in range(8000)]
    run = Run(trajectory)
    run.go(2.0)
    run.executor.hold()
    run.go(0.2)
    assert not run.executor.moving
    assert run.executor.held
    held = run.motions[-1]
    assert at_rest(held)
    run.go(1.0)
    assert run.motions[-1] == held
    run.executor.resume()
    run.go(7.0)
    assert run.executor.done
    for motion in run.motions[1::7]:  # every command lies on the path
        nearest = min(math.hypot(p.angles[0] - motion.angles[0], p.angles[1] - motion.angles[1]) for p in free)
        assert nearest < 1e-3


def test_reported_rates_match_the_commands_while_slowing_down() -> None:
    run = Run(plan(SWING))
    run.go(2.0)
    run.executor.hold()
    run.go(0.3)
    run.executor.resume()
    run.go(0.5)
    for before, here in zip(run.motions, run.motions[1:], strict=False):
        mean_rate = 0.5 * (before.rates[0] + here.rates[0])
        assert (here.angles[0] - before.angles[0]) / DT == pytest.approx(mean_rate, abs=math.radians(3))


def test_stop_discards_the_plan_once_the_palms_stand() -> None:
    run = Run(plan(SWING))
    run.go(2.0)
    run.executor.stop()
    assert run.executor.moving
    run.go(0.3)
    assert not run.executor.moving
    assert run.executor.plan is None
    with pytest.raises(MotionError, match="no plan is being held"):
        run.executor.resume()


def test_a_plan_can_start_after_a_stop_while_held() -> None:
    run = Run(plan(SWING))
    run.go(2.0)
    run.executor.hold()
    run.go(0.5)
    run.executor.stop()
    assert run.executor.plan is None
    stood = run.motions[-1]
    run.executor.start(plan(SWING))
    first = run.go(DT)
    assert math.hypot(first.angles[0] - stood.angles[0], first.angles[1] - stood.angles[1]) < 1e-3
    run.go(1.0)
    assert run.executor.moving


def test_a_start_is_refused_while_moving_without_a_pose_or_from_outside() -> None:
    run = Run(plan(SWING))
    run.go(1.0)
    with pytest.raises(MotionError, match="moving"):
        run.executor.start(plan(SWING))
    with pytest.raises(MotionError, match="pose is not known"):
        TrajectoryExecutor(LIMITS).start(plan(SWING))
    outside = TrajectoryExecutor(LIMITS)
    outside.stand((math.radians(2), math.radians(90)))
    with pytest.raises(MotionError, match=r"no way .* plan test: phi1 falls to 2°"):
        outside.start(plan(SWING))


def test_a_late_call_delays_the_motion_and_never_jumps() -> None:
    trajectory = plan(SWING)
    run = Run(trajectory)
    run.go(2.0)
    before = run.motions[-1]
    late = run.executor.advance(run.t + 5.0)
    assert abs(late.angles[0] - before.angles[0]) <= LIMITS.rate * LONGEST_STEP
    assert angles(late) == pytest.approx(angles(trajectory.at(run.t - 100.0 + LONGEST_STEP)), abs=1e-9)


def test_an_earlier_time_changes_nothing() -> None:
    run = Run(plan(SWING))
    run.go(2.0)
    assert run.executor.advance(run.t - 0.5) == run.motions[-1]
    assert run.executor.advance(run.t) == run.motions[-1]


def test_hold_before_the_first_advance_keeps_the_palms_where_they_are() -> None:
    run = Run(plan(SWING))
    run.executor.hold()
    assert angles(run.go(1.0)) == pytest.approx(HOME, abs=1e-9)
    assert at_rest(run.motions[-1])
    assert run.executor.held


def test_an_exploration_is_available_from_its_start_to_its_conclusion() -> None:
    run = Run(plan({"move": {"phi1_deg": 45, "phi2_deg": 90}, "duration_s": 0.4}, {"explore": {}}))
    run.go(0.3)
    assert run.executor.exploration is None  # still on the approach
    run.go(0.5)
    found = run.executor.exploration
    assert found is not None
    exploration, t = found
    assert t == pytest.approx(0.4, abs=2 * DT)
    exploration.append(Move(HOME, (1.0, 1.5), 0.5), t)
    run.go(0.2)
    assert not at_rest(run.motions[-1])
    run.go(0.5)
    assert run.executor.moving
    run.executor.conclude()
    assert run.executor.done
    assert not run.executor.moving
    assert not run.executor.held
    assert run.executor.exploration is None
    assert angles(run.go(0.5)) == (1.0, 1.5)
    run.executor.start(plan({"explore": {}}))
    run.go(0.1)
    assert not run.executor.done


def test_a_move_cut_while_held_leaves_the_palms_where_they_stand() -> None:
    run = Run(plan({"explore": {}}))
    run.go(0.1)
    assert run.executor.exploration is not None
    exploration, t = run.executor.exploration
    exploration.append(Move(HOME, (1.0, 1.5), 0.8), t)
    run.go(0.3)
    run.executor.hold()
    stood = run.go(0.4)
    assert HOME[0] < stood.angles[0] < 1.0
    found = run.executor.exploration
    assert found is not None
    exploration.cut(found[1])
    run.executor.resume()
    assert angles(run.go(1.0)) == pytest.approx(angles(stood), abs=1e-12)
    assert exploration.last.end == pytest.approx(angles(stood), abs=1e-12)
