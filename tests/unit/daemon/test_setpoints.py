"""Set-points and jog: what is sent to the arm, and the last guard before it."""

import itertools
import math

import pytest

from palmd.config.arms import AdeptConfig
from palmd.config.pads import VersaPadConfig
from palmd.config.two_palms import Config, PadsConfig, PlanSpec
from palmd.daemon.jog import DEAD_MAN_S
from palmd.daemon.poses import ArcPoses
from palmd.daemon.setpoints import SetPoints
from palmd.events import PalmMotion
from palmd.motion.check import motion_limits
from palmd.motion.kinematics import RigGeometry
from palmd.motion.limits import Workspace
from palmd.motion.plan import compile_plan
from palmd.motion.trajectory_executor import MotionError

CYCLE = 0.016
CONFIG = Config(
    pads=PadsConfig(palm1=VersaPadConfig(port="a"), palm2=VersaPadConfig(port="b")), arm=AdeptConfig(port="c")
)
GEOMETRY = RigGeometry.from_config(CONFIG)
POSES = ArcPoses(GEOMETRY)
LIMITS = motion_limits(CONFIG)
HERE = PalmMotion.at_rest((math.radians(45.0), math.radians(90.0)))


def trajectory(phi1_deg=60.0, then_phi1_deg=None, then_phi2_deg=90.0):
    segments = [{"move": {"phi1_deg": phi1_deg, "phi2_deg": 90}, "duration_s": 1.0}, {"hold_s": 1.0}]
    if then_phi1_deg is not None:
        segments.append({"move": {"phi1_deg": then_phi1_deg, "phi2_deg": then_phi2_deg}, "duration_s": 1.0})
    return compile_plan(PlanSpec.model_validate({"name": "there", "segments": segments}), LIMITS)


def tool_of(motion: PalmMotion) -> float:
    return GEOMETRY.arm_pose(motion.angles)[2]


class Drive:
    """Set-points that are all sent, one each cycle."""

    def __init__(self, pose=HERE, workspace=None):
        self.setpoints = SetPoints(POSES, LIMITS)
        self.setpoints.set_workspace(workspace)
        self.t = 10.0
        self.setpoints.stand(pose, POSES.pose(pose.angles), self.t)

    def go(self, seconds):
        sent = []
        for _ in range(round(seconds / CYCLE)):
            self.t += CYCLE
            pose = self.setpoints.target(self.t)
            motion = self.setpoints.sent(self.t)
            assert (pose.x_m, pose.y_m) == pytest.approx(GEOMETRY.arm_pose(motion.angles)[:2])
            sent.append(motion)
        return sent


def test_set_points_start_at_the_arms_position():
    assert all(motion.angles[0] == pytest.approx(HERE.angles[0]) for motion in Drive().go(0.2))


def test_only_a_requested_pose_outside_the_limits_violates_them(monkeypatch):
    drive = Drive()
    drive.setpoints.start(trajectory())
    drive.go(1.5)
    assert not drive.setpoints.violated
    outside = PalmMotion.at_rest((math.radians(151.0), math.radians(10.0)))
    monkeypatch.setattr(drive.setpoints._executor, "advance", lambda _t: outside)
    drive.go(CYCLE)
    assert drive.setpoints.violated


def test_a_freeze_ends_by_itself_but_not_during_a_hold():
    drive = Drive()
    drive.setpoints.start(trajectory())
    drive.go(0.4)
    drive.setpoints.freeze(True)
    drive.go(0.3)
    a, *_, b = drive.go(0.1)
    assert a.angles[0] == b.angles[0]
    drive.setpoints.hold()
    drive.setpoints.freeze(False)
    assert drive.go(0.2)[-1].angles[0] == b.angles[0]
    drive.setpoints.freeze(True)
    drive.setpoints.resume()
    assert drive.go(0.2)[-1].angles[0] == b.angles[0]
    drive.setpoints.freeze(False)
    assert math.degrees(drive.go(3.0)[-1].angles[0]) == pytest.approx(60.0)


def test_the_end_of_a_pause_does_not_end_a_hold():
    drive = Drive()
    drive.setpoints.start(trajectory())
    drive.go(0.4)
    drive.setpoints.pause(True)
    drive.go(0.3)
    assert not drive.setpoints.moving
    drive.setpoints.hold()
    drive.setpoints.pause(False)
    assert drive.setpoints.held
    drive.setpoints.resume()
    assert math.degrees(drive.go(3.0)[-1].angles[0]) == pytest.approx(60.0)


def test_a_displaced_arm_returns_at_a_limited_rate_and_then_continues():
    drive = Drive()
    drive.setpoints.start(trajectory())
    before = drive.go(0.5)[-1]
    actual = PalmMotion.at_rest((before.angles[0] - math.radians(5.0), before.angles[1] + math.radians(3.0)))
    drive.setpoints.restart_at(actual, POSES.pose(actual.angles))
    motions = [actual, *drive.go(0.1)]
    steps = [b.angles[0] - a.angles[0] for a, b in itertools.pairwise(motions)]
    assert max(map(abs, steps)) <= 0.25 * LIMITS.rate * CYCLE * (1 + 1e-9)
    assert drive.setpoints.commanded.angles[0] > actual.angles[0]
    assert math.degrees(drive.go(4.0)[-1].angles[0]) == pytest.approx(60.0)


def test_a_joint_that_need_not_follow_never_counts_as_displaced():
    """The pivot on a slide stands millimetres above the commanded stop."""
    setpoints = SetPoints(POSES, LIMITS, free=(1,))
    setpoints.stand(HERE, POSES.pose(HERE.angles), 10.0)
    off = PalmMotion.at_rest(tuple(angle + math.radians(2.0) for angle in HERE.angles))
    setpoints.restart_at(off, POSES.pose(off.angles))
    assert setpoints.commanded.angles == (off.angles[0], HERE.angles[1])


def test_the_path_waits_for_a_displaced_arm():
    drive = Drive()
    drive.setpoints.start(trajectory(phi1_deg=45.0, then_phi1_deg=60.0))
    before = drive.go(1.4)[-1]
    actual = PalmMotion.at_rest((before.angles[0], before.angles[1] + math.radians(15.0)))
    drive.setpoints.restart_at(actual, POSES.pose(actual.angles))
    drive.go(0.2)
    waiting = drive.setpoints.place
    drive.go(0.2)
    assert drive.setpoints.place == waiting
    drive.go(0.5)
    assert drive.setpoints.place.progress > waiting.progress


def test_a_twisted_tool_turns_back_at_a_limited_rate():
    drive = Drive()
    twist = math.radians(4.0)
    drive.setpoints.stand(HERE, POSES.pose(HERE.angles, twist), drive.t)
    tools = [tool_of(HERE) + twist]
    for _ in range(40):
        drive.t += CYCLE
        tools.append(drive.setpoints.target(drive.t).t_rad)
        drive.setpoints.sent(drive.t)
    steps = [abs(b - a) for a, b in itertools.pairwise(tools)]
    assert 0.0 < max(steps) <= 0.25 * LIMITS.rate * CYCLE * (1 + 1e-9)
    assert tools[-1] == pytest.approx(tool_of(HERE))


def test_a_pose_outside_the_limits_by_more_than_noise_cannot_be_tracked():
    setpoints = SetPoints(POSES, LIMITS)
    low = LIMITS.angles[0][0]
    assert setpoints.tracking_problems(HERE) == []
    assert setpoints.tracking_problems(PalmMotion.at_rest((low - math.radians(0.02), HERE.angles[1]))) == []
    (problem,) = setpoints.tracking_problems(PalmMotion.at_rest((low - math.radians(0.1), HERE.angles[1])))
    assert "phi1 falls to 5.9°" in problem


def test_set_points_outside_the_arms_workspace_are_not_sent():
    drive = Drive()
    x, y, _ = GEOMETRY.arm_pose(HERE.angles)
    drive.setpoints.leave()
    drive.setpoints.set_workspace(Workspace(GEOMETRY, x - 0.005, x + 0.005, y - 0.005, y + 0.005, 2.0, 50.0))
    drive.setpoints.stand(HERE, POSES.pose(HERE.angles), drive.t)
    drive.setpoints.start(trajectory(then_phi1_deg=60.0, phi1_deg=45.0))
    motions = drive.go(3.0)
    xs = [GEOMETRY.arm_pose(motion.angles)[0] for motion in motions]
    assert max(abs(each - x) for each in xs) <= 0.005
    assert drive.setpoints.violated


def test_palms_that_stand_outside_the_arms_workspace_stay_there():
    """No set-point can be requested there, and sending none would lose the link."""
    x, y, _ = GEOMETRY.arm_pose(HERE.angles)
    drive = Drive(workspace=Workspace(GEOMETRY, x + 0.01, x + 0.1, y - 0.1, y + 0.1, 2.0, 50.0))
    assert {motion.angles for motion in drive.go(0.1)} == {HERE.angles}
    assert drive.setpoints.violated


@pytest.mark.parametrize(("axis", "way"), [(0, -1), (0, 1), (1, -1), (1, 1)])
def test_set_points_beyond_any_single_edge_of_the_workspace_are_not_sent(axis, way):
    """The other three edges are far, so only one of them is violated."""
    box = [-9.0, 9.0, -9.0, 9.0]
    here = GEOMETRY.arm_pose(HERE.angles)[axis]
    box[2 * axis + (way > 0)] = here + way * 0.002
    phi1_deg, phi2_deg = next(
        (phi1, phi2)
        for phi1, phi2 in ((30, 90), (60, 90), (45, 60), (45, 120))
        if way * (GEOMETRY.arm_pose((math.radians(phi1), math.radians(phi2)))[axis] - here) > 0.01
    )
    drive = Drive(workspace=Workspace(GEOMETRY, *box, 2.0, 50.0))
    drive.setpoints.start(trajectory(45.0, phi1_deg, phi2_deg))
    reached = [way * (GEOMETRY.arm_pose(motion.angles)[axis] - here) for motion in drive.go(4.0)]
    assert max(reached) <= 0.002
    assert drive.setpoints.violated


def test_after_leaving_tracking_there_is_no_target():
    drive = Drive()
    drive.setpoints.start(trajectory())
    drive.setpoints.leave()
    assert drive.setpoints.target(drive.t + CYCLE) is None
    assert drive.setpoints.commanded is None
    assert not drive.setpoints.moving


# ---- jog


def jogged(drive, steps, every=0.048, phi1_deg=0.5):
    motions = []
    for _ in range(steps):
        drive.setpoints.jog((math.radians(phi1_deg), 0.0), drive.t)
        motions += drive.go(every)
    return motions


@pytest.mark.parametrize("why", ["frozen", "displaced"])
def test_a_jog_waits_until_the_arm_follows(why):
    drive = Drive()
    if why == "frozen":
        drive.setpoints.freeze(True)
    else:
        away = PalmMotion.at_rest((HERE.angles[0] + 0.1, HERE.angles[1]))
        drive.setpoints.restart_at(away, POSES.pose(away.angles))
    with pytest.raises(MotionError, match="does not follow"):
        drive.setpoints.jog((math.radians(0.5), 0.0), drive.t)


def test_a_jog_moves_while_steps_arrive_and_stops_soon_after():
    drive = Drive()
    motions = jogged(drive, 20)
    went = motions[-1].angles[0] - HERE.angles[0]
    assert math.degrees(went) > 5.0
    assert drive.setpoints.moving
    after = drive.go(DEAD_MAN_S + 0.2)
    assert math.degrees(after[-1].angles[0] - motions[-1].angles[0]) < 2.5
    assert not drive.setpoints.moving
    assert drive.go(0.5)[-1].angles[0] == after[-1].angles[0]


def test_a_jog_abandons_its_goal_when_the_steps_stop():
    drive = Drive()
    for _ in range(8):
        drive.setpoints.jog((math.radians(0.5), 0.0), drive.t)
    drive.go(DEAD_MAN_S)
    assert drive.setpoints.moving
    rest = drive.go(0.15)[-1]
    assert not drive.setpoints.moving
    assert math.degrees(rest.angles[0] - HERE.angles[0]) < 1.9


def test_a_jog_has_limited_rate_and_acceleration():
    rates = [abs(motion.rates[0]) for motion in jogged(Drive(), 30)]
    assert math.degrees(max(rates)) <= 10.0 + 1e-9
    changes = [abs(b - a) for a, b in itertools.pairwise(rates)]
    assert math.degrees(max(changes)) <= 100.0 * CYCLE + 1e-9


def test_a_jog_reaches_its_goal_and_rests_there():
    drive = Drive()
    drive.setpoints.jog((math.radians(0.3), math.radians(-0.1)), drive.t)
    drive.go(0.15)
    drive.setpoints.jog((0.0, 0.0), drive.t)
    last = drive.go(0.19)[-1]
    assert math.degrees(last.angles[0] - HERE.angles[0]) == pytest.approx(0.3, abs=1e-6)
    assert math.degrees(last.angles[1] - HERE.angles[1]) == pytest.approx(-0.1, abs=1e-6)


def test_a_jog_never_leaves_the_limits():
    drive = Drive(PalmMotion.at_rest((math.radians(7.0), math.radians(90.0))))
    with pytest.raises(MotionError, match="phi1 falls to"):
        jogged(drive, 20, phi1_deg=-0.5)
    assert drive.go(1.0)[-1].angles[0] >= LIMITS.angles[0][0]


BOX = Workspace(GEOMETRY, 0.20, 0.40, -0.07, 0.072, 1.0, 10.0)  # the path by (-39, -54) leaves it and returns


def jogged_by(drive, way, *, whole):
    """Steps that add up to a path (rad), `whole` declared with the first one or not; the last motion."""
    steps = 150
    for number in range(steps):
        drive.setpoints.jog((way[0] / steps, way[1] / steps), drive.t, way if whole and number == 0 else None)
        drive.go(0.064)
    drive.setpoints.jog((0.0, 0.0), drive.t)
    return drive.go(0.19)[-1]


@pytest.mark.parametrize("workspace", [None, BOX])
@pytest.mark.parametrize("way", [(40, 0), (90, 0), (-30, 40), (-39, -54), (-50, 0), (0, -54), (-35, 60), (60, -40)])
def test_a_jog_is_refused_at_its_first_step_or_completed(workspace, way):
    drive = Drive(workspace=workspace)
    way = (math.radians(way[0]), math.radians(way[1]))
    try:
        last = jogged_by(drive, way, whole=True)
    except MotionError:
        assert drive.t == 10.0
        assert drive.go(0.5)[-1] == HERE
        with pytest.raises(MotionError):  # the refusal is correct
            jogged_by(drive, way, whole=False)
    else:
        assert last.angles == pytest.approx((HERE.angles[0] + way[0], HERE.angles[1] + way[1]), abs=1e-6)
        assert drive.setpoints.interventions == 0


def test_jog_and_plan_exclude_each_other():
    drive = Drive()
    drive.setpoints.start(trajectory())
    drive.go(0.3)
    with pytest.raises(MotionError, match="hold it first"):
        drive.setpoints.jog((0.001, 0.0), drive.t)
    drive.setpoints.hold()
    drive.go(0.5)
    jogged(drive, 3)
    with pytest.raises(MotionError, match="being jogged"):
        drive.setpoints.start(trajectory())
    drive.go(1.0)
    drive.setpoints.start(trajectory())
    assert math.degrees(drive.go(4.0)[-1].angles[0]) == pytest.approx(60.0)
    assert drive.setpoints.interventions == 0


def test_a_jog_needs_an_arm_that_follows():
    with pytest.raises(MotionError, match="does not follow"):
        SetPoints(POSES, LIMITS).jog((0.001, 0.0), 0.0)


@pytest.mark.parametrize("late_s", [0.0, 0.001, CYCLE])
def test_the_return_to_a_displaced_arm_keeps_the_rate_limit_after_a_late_set_point(late_s):
    drive = Drive()
    drive.setpoints.start(trajectory())
    drive.go(0.8)
    out = drive.setpoints.commanded
    drive.setpoints.retreat(HERE, drive.t)
    before, most = out, CYCLE * math.radians(CONFIG.limits.rate_deg_s)
    for _ in range(5):
        drive.t += CYCLE + late_s
        drive.setpoints.target(drive.t)
        after = drive.setpoints.sent(drive.t)
        assert abs(after.angles[0] - before.angles[0]) <= most * (1 + 1e-9)
        before = after
    assert before.angles[0] < out.angles[0] - math.radians(2.0)
