"""No set-point leaves the limits or exceeds the allowed step, whatever is requested."""

import contextlib
import math

from hypothesis import given, settings
from hypothesis import strategies as st
from palms import motion_of

from palmd.config.arms import AdeptConfig
from palmd.config.pads import VersaPadConfig
from palmd.config.two_palms import Config, PadsConfig, PlanSpec
from palmd.daemon.poses import ArcPoses
from palmd.daemon.setpoints import LONGEST_STEP_S, SetPoints
from palmd.events import PalmMotion
from palmd.motion.check import motion_limits
from palmd.motion.kinematics import RigGeometry
from palmd.motion.limits import PHI12_MAX
from palmd.motion.plan import Trajectory, compile_plan
from palmd.motion.segments import Hold
from palmd.motion.trajectory_executor import MotionError

CONFIG = Config(
    pads=PadsConfig(palm1=VersaPadConfig(port="a"), palm2=VersaPadConfig(port="b")), arm=AdeptConfig(port="c")
)
GEOMETRY = RigGeometry.from_config(CONFIG)
POSES = ArcPoses(GEOMETRY)
LIMITS = motion_limits(CONFIG)
HERE = PalmMotion.at_rest((math.radians(45.0), math.radians(90.0)))
SPEC = PlanSpec.model_validate(
    {
        "name": "lively",
        "repeat": "forever",
        "segments": [
            {"move": {"phi1_deg": 30, "phi2_deg": 90}, "duration_s": 1.0},
            {"sine": {"phi1_deg": 12, "phi2_deg": 8}, "frequency_hz": [0.9, 0.7], "duration_s": 6},
        ],
        "dither": {"amplitude_deg": 0.05, "frequency_hz": 10},
    }
)
GOOD = compile_plan(SPEC, LIMITS)


class Rogue(Hold):
    """A segment without checks: it jumps, leaves every limit and is sometimes NaN."""

    def at(self, t: float) -> PalmMotion:
        jumps = (0.8, 7.0, -3.0, math.nan, 1e9, math.inf, 2.9)
        return PalmMotion((jumps[int(t * 40) % 7], jumps[int(t * 23) % 7]), (50.0, -50.0), (1e4, 1e4))


def rogue() -> Trajectory:
    checked = compile_plan(
        PlanSpec.model_validate({"name": "rogue", "segments": [{"hold_s": 5.0}]}), LIMITS, HERE.angles
    )
    (one,) = checked.rounds
    segment = Rogue(HERE.angles, one.duration)
    object.__setattr__(one, "segments", (segment,))
    return checked


angles = st.tuples(st.floats(0.2, 1.2), st.floats(0.8, 1.6))
acts = st.one_of(
    st.tuples(st.sampled_from(["start", "rogue", "hold", "resume", "freeze", "thaw", "put_away"]), st.none()),
    st.tuples(st.just("displaced"), angles),
    st.tuples(st.just("jog"), st.tuples(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01))),
    st.tuples(st.just("stand"), angles),
    st.tuples(st.just("pause"), st.floats(0.0, 0.5)),
)


def do(setpoints: SetPoints, what: str, how, t: float) -> bool:
    """Sends a request; returns whether the arm's pose was reported to differ."""
    with contextlib.suppress(MotionError):
        match what:
            case "start":
                setpoints.start(GOOD)
            case "rogue":
                setpoints.start(rogue())
            case "hold":
                setpoints.hold()
            case "resume":
                setpoints.resume()
            case "freeze" | "thaw":
                setpoints.freeze(what == "freeze")
            case "put_away":
                setpoints.discard_plan()
            case "jog":
                setpoints.jog(how, t)
            case "displaced":
                setpoints.restart_at(motion_of(how), POSES.pose(HERE.angles))
                return True
            case "stand":
                setpoints.stand(motion_of(how), POSES.pose(HERE.angles), t)
                return True
    return False


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(acts, st.integers(0, 12), st.floats(0.012, 0.030)), max_size=25), st.randoms())
def test_set_points_keep_limits_and_steps_for_any_requests(script, random):
    setpoints, t = SetPoints(POSES, LIMITS), 100.0
    setpoints.stand(HERE, POSES.pose(HERE.angles), t)
    last, t_last = HERE, t
    for (what, how), cycles, period in script:
        if what == "pause":
            t += how
        elif do(setpoints, what, how, t):
            last, t_last = motion_of(how), t
        for _ in range(cycles):
            t += period
            pose = setpoints.target(t)
            assert pose is not None
            if random.random() < 0.1:
                continue  # no free space in the line
            setpoints.sent(t)
            phi1, phi2 = GEOMETRY.palm_angles(pose.x_m, pose.y_m)
            assert LIMITS.angles[0][0] - 1e-9 <= phi1 <= LIMITS.angles[0][1] + 1e-9
            assert LIMITS.angles[1][0] - 1e-9 <= phi2 <= LIMITS.angles[1][1] + 1e-9
            assert phi1 + phi2 < PHI12_MAX
            step = max(abs(phi1 - last.angles[0]), abs(phi2 - last.angles[1]))
            room = LIMITS.rate * min(max(t - t_last, period), LONGEST_STEP_S)
            assert step <= room + 1e-9
            last, t_last = PalmMotion.at_rest((phi1, phi2)), t
