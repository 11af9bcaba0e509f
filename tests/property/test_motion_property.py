"""Random plans with random holds, resumes, stops and late calls keep every limit of the command."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from palms import motion_of

from palmd.config.two_palms import PlanSpec
from palmd.events import PalmMotion
from palmd.motion.kinematics import RigGeometry
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import PlanError, Trajectory, compile_plan
from palmd.motion.trajectory_executor import MotionError, TrajectoryExecutor


def _limits(roomier_deg: float = 0.0) -> MotionLimits:
    return MotionLimits(
        angles=(
            (math.radians(6 - roomier_deg), math.radians(150 + roomier_deg)),
            (math.radians(35 - roomier_deg), math.radians(155 + roomier_deg)),
        ),
        rate=math.radians(120),
        acceleration=math.radians(900),
        pad_length=0.0555,
    )


LIMITS = _limits()
ROOMY = _limits(0.05)  # extremes of a plan are sampled, to about 0.1 % of a swing
START = (math.radians(45), math.radians(90))

phi1_deg = st.floats(10, 70)
phi2_deg = st.floats(60, 100)
frequency = st.floats(0.1, 1.5)


def _rate(angle: str, target: float, other: float) -> dict[str, Any]:
    centre = {"phi1": 45.0, "phi2": 90.0}[angle]
    return {"rate": {f"{angle}_deg_s": math.copysign(other, target - centre)}, "until": {f"{angle}_deg": target}}


move = st.builds(
    lambda a, b, t: {"move": {"phi1_deg": a, "phi2_deg": b}, "duration_s": t}, phi1_deg, phi2_deg, st.floats(0.3, 3)
)
hold = st.builds(lambda t: {"hold_s": t}, st.floats(0.01, 1))
sine = st.builds(
    lambda a, b, f, t: {"sine": {"phi1_deg": a, "phi2_deg": b}, "frequency_hz": f, "duration_s": t},
    st.floats(-25, 25),
    st.floats(-15, 15),
    st.lists(frequency, min_size=2, max_size=2),
    st.floats(0.2, 5),
)
home_move = {"move": {"phi1_deg": 45.0, "phi2_deg": 90.0}, "duration_s": 1.5}
rate = st.one_of(
    st.builds(_rate, st.just("phi1"), phi1_deg, st.floats(1, 110)),
    st.builds(_rate, st.just("phi2"), phi2_deg, st.floats(1, 110)),
).map(lambda segment: [home_move, segment])
piece = st.one_of(move.map(lambda m: [m]), hold.map(lambda h: [h]), sine.map(lambda s: [s]), rate)
dither = st.one_of(
    st.none(),
    st.builds(lambda a, f: {"amplitude_deg": a, "frequency_hz": f}, st.floats(0.01, 0.1), st.floats(2.0, 11.0)),
)


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    segments = [segment for part in draw(st.lists(piece, min_size=1, max_size=4)) for segment in part]
    spec = PlanSpec.model_validate(
        {
            "name": "random",
            "segments": segments,
            "repeat": draw(st.sampled_from([1, 2, 3, "forever"])),
            "dither": draw(dither),
        }
    )
    try:
        return compile_plan(spec, LIMITS, START)
    except PlanError:
        assume(False)
        raise


def _pairs(motion: PalmMotion) -> tuple[tuple[float, float, float], ...]:
    return (motion.angles[0], motion.rates[0], motion.accelerations[0]), (
        motion.angles[1],
        motion.rates[1],
        motion.accelerations[1],
    )


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow])
@given(trajectories(), st.randoms(use_true_random=False))
def test_derivatives_are_consistent_and_limits_hold_everywhere(trajectory: Trajectory, random: Any) -> None:
    """Rates and accelerations agree with central differences of the angles."""
    last = min(trajectory.duration, 40.0)
    joints = [sum(done.duration for done in trajectory.rounds[:n]) for n in range(len(trajectory.rounds) + 1)]
    times = [random.uniform(0.0, last) for _ in range(60)] + [t for t in joints if t <= last]
    h = 2e-5
    for t in times:
        before, here, after = (trajectory.at(t + d) for d in (-h, 0.0, h))
        inside = h < t < trajectory.duration - h
        for (a, va, _), (_, vb, ab), (c, vc, _) in zip(_pairs(before), _pairs(here), _pairs(after), strict=True):
            assert abs(vb) <= LIMITS.rate * 1.003
            assert abs(ab) <= LIMITS.acceleration * 1.003
            if inside:
                assert (c - a) / (2 * h) == pytest.approx(vb, abs=1e-4)
                assert (vc - va) / (2 * h) == pytest.approx(ab, abs=0.02)
        assert not ROOMY.violations(here.angles)


commands = st.lists(
    st.tuples(st.integers(1, 120), st.sampled_from(["hold", "resume", "stop", "start", "nothing"])),
    min_size=2,
    max_size=12,
)


def _obey(executor: TrajectoryExecutor, command: str, trajectory: Trajectory) -> None:
    try:
        if command == "hold":
            executor.hold()
        elif command == "stop":
            executor.stop()
        elif command == "resume":
            executor.resume()
        elif command == "start":
            executor.start(trajectory)
    except MotionError:
        pass  # refused at this moment: no effect


@pytest.mark.parametrize("dt", [0.010, 0.016])
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow])
@given(trajectories(), commands)
def test_commands_keep_rate_and_acceleration_limits_for_any_requests(
    dt: float, trajectory: Trajectory, commands: list[tuple[int, str]]
) -> None:
    executor = TrajectoryExecutor(LIMITS)
    executor.stand(START)
    executor.start(trajectory)
    t = 0.0
    command = [executor.advance(t)]
    for count, request in commands:
        for _ in range(count):
            t += dt
            command.append(executor.advance(t))
        _obey(executor, request, trajectory)
    worst = 0.0
    for a, b, c in zip(command, command[1:], command[2:], strict=False):
        for before, here, after in ((a.angles[0], b.angles[0], c.angles[0]), (a.angles[1], b.angles[1], c.angles[1])):
            assert abs(after - here) <= LIMITS.rate * dt * (1 + 1e-6)
            worst = max(worst, abs(after - 2 * here + before) / (dt * dt))
        assert not ROOMY.violations(b.angles)
    assert worst <= LIMITS.acceleration * 1.001


lengths = st.floats(0.05, 0.5)
offsets = st.floats(-1.0, 1.0)


@settings(max_examples=200, deadline=None)
@given(
    st.builds(RigGeometry, offsets, offsets, lengths, lengths, offsets, offsets, st.floats(-7.0, 7.0)),
    st.floats(-3.1, 3.1),
    st.floats(math.radians(2), math.radians(178)),
)
def test_arm_pose_and_palm_angles_are_inverses(geometry: RigGeometry, phi1: float, phi2: float) -> None:
    x, y, t = geometry.arm_pose((phi1, phi2))
    back1, back2 = geometry.palm_angles(x, y)
    assert math.remainder(back1 - phi1, math.tau) == pytest.approx(0.0, abs=1e-7)
    assert back2 == pytest.approx(phi2, abs=1e-7)
    assert math.remainder(t + geometry.arm_yaw - phi1 - phi2, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert -math.pi < t <= math.pi


angle = st.floats(-4.0, 4.0) | st.sampled_from([math.nan, math.inf, -math.inf])


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(angle, angle), min_size=1, max_size=30), st.floats(0.0, 0.1))
def test_clamped_steps_keep_the_limits_and_the_rate(requests: list[tuple[float, float]], dt: float) -> None:
    last = PalmMotion.at_rest(START)
    for request in requests:
        sent = LIMITS.clamp_step(last, motion_of(request), dt)
        assert not LIMITS.violations(sent.angles)
        assert (
            max(abs(sent.angles[0] - last.angles[0]), abs(sent.angles[1] - last.angles[1])) <= LIMITS.rate * dt + 1e-12
        )
        last = sent
