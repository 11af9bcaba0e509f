"""A refused command moves nothing, for any command, client, state and pose."""

import copy
import math
from functools import cache

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from virtual_rig import AtOnce

from palmd.bus.jogging import JOG_EVERY_S, jog_steps
from palmd.config.two_palms import PlanSpec
from palmd.daemon.commands import COMMANDS, Request
from palmd.daemon.core import Core
from palmd.daemon.planner import Plan
from palmd.daemon.setpoints import SetPoints
from palmd.events import PalmMotion
from palmd.motion.check import motion_limits
from palmd.motion.plan import compile_plan
from palmd.motion.segments import Angles
from palmd.motion.trajectory_executor import MotionError
from palmd.rig.fault_injection import order
from palmd.rig.world import default_config
from tools.studies.simulation.light_rig import STEP_S, LightRig
from tools.studies.simulation.scenario import PLAN_TEXTS
from tools.studies.stub_observers import TrivialObserver

CONFIG = default_config()
LIMITS = motion_limits(CONFIG)
CYCLE_S, CYCLES = 0.016, 60
SPEC = PlanSpec.model_validate(yaml.safe_load(PLAN_TEXTS[0]))
PLAN = Plan(SPEC, compile_plan(SPEC, LIMITS), LIMITS, None)


class Bench:
    """Core and light rig, step by step."""

    def __init__(self):
        self.rig, self.core = LightRig(CONFIG, 3), Core(CONFIG, TrivialObserver(), AtOnce(), PLAN)
        self.ticks = 0
        self.closed = set()
        self.answers = []
        for end in self.core.ports():
            self.core.opened(end, 0.0)

    @property
    def t(self):
        return self.ticks * 0.01

    def go(self, ticks):
        """Runs so many ticks; returns the bytes written to the arm with their times."""
        written = []
        for _ in range(ticks):
            for step in range(10):
                t = self.t + (step + 1) * STEP_S
                for end, data in self.rig.advance(t + 1e-9).items():
                    if end not in self.closed:
                        self.core.receive(end, data, t)
                if t >= self.core.due():
                    written.append((t, self.core.transmit(t)))
                    self.rig.receive("arm", written[-1][1])
            self.ticks += 1
            self.core.observe(self.t)
            self.core.decide(self.t)
            self.answers += self.core.replies()
        return written

    def ask(self, name, **args):
        """Sends a command; returns the reason of its refusal, None when granted."""
        self.core.handle(Request(name, args, id=name), self.t)
        for _ in range(130):
            self.answers += self.core.replies()
            if self.answers:
                answer = self.answers.pop()
                self.answers.clear()
                return answer.error
            self.go(1)
        raise AssertionError(f"{name} was not answered")

    def play(self, name, **how):
        self.rig.fault_injector.add(order(name, self.rig.t, **how))

    def copy(self):
        shared = (CONFIG, LIMITS, PLAN, self.core.setpoints.limits)
        return copy.deepcopy(self, {id(each): each for each in shared})


def idle():
    bench = Bench()
    bench.closed.add("pad2")
    bench.core.lost("pad2", 0.0)
    bench.go(30)
    return bench


def ready():
    bench = Bench()
    bench.go(30)
    return bench


def after(before, name, ticks, **args):
    """A granted command, and so many ticks."""
    bench = before()
    assert bench.ask(name, **args) is None
    bench.go(ticks)
    return bench


def armed():
    return after(ready, "arm", 20)


def running():
    return after(armed, "start", 90)


def held():
    return after(running, "hold", 60)


def jogged():
    return after(armed, "jog", 3, phi1_deg=0.4)


def at_a_limit():
    """Palm 1 close to its lower limit."""
    bench = armed()
    while bench.ask("jog", phi1_deg=-0.5) is None:
        bench.go(4)
    bench.go(60)
    return bench


def disturbed(fault, ticks, **how):
    bench = running()
    bench.play(fault, **how)
    bench.go(ticks)
    return bench


def lifted():
    bench = disturbed("lift", 60)
    assert str(bench.core.state) == "hold"
    return bench


def stopped():
    bench = disturbed("estop", 60)
    assert str(bench.core.state) == "fault"
    return bench


def late():
    """The arm does not answer; the motion is frozen."""
    return disturbed("late", 12, port="arm", strength=0.15)


def ending():
    bench = running()
    bench.core.close()
    bench.go(5)
    return bench


STATES = (idle, ready, armed, running, held, jogged, at_a_limit, lifted, stopped, late, ending)
prepared = cache(lambda state: state())


def values(argument):
    if argument.kind == "text":
        return st.sampled_from(["no plan", *PLAN_TEXTS]) if argument.name == "text" else st.just("sent.yaml")
    low, high = max(argument.low, -1e9), min(argument.high, 1e9)
    return st.floats(low, high) | st.sampled_from([low, high, 0.0])


@st.composite
def commands(draw):
    name = draw(st.sampled_from(sorted(COMMANDS)))
    given_ones = [a for a in COMMANDS[name].arguments if a.required or draw(st.booleans())]
    return name, {argument.name: draw(values(argument)) for argument in given_ones}


@pytest.mark.parametrize("state", STATES, ids=lambda state: state.__name__)
@settings(max_examples=12, deadline=None, derandomize=True)
@given(commands())
def test_a_refused_command_leaves_the_bytes_to_the_arm_unchanged(state, command):
    check(state, *command)


ALWAYS = (
    *((name, {}) for name in ("arm", "start", "hold", "stop", "reset", "status")),
    *(("jog", {"phi1_deg": step, **whole}) for step in (-0.5, 0.5) for whole in ({}, {"whole_phi1_deg": 200 * step})),
)


@pytest.mark.parametrize("state", STATES, ids=lambda state: state.__name__)
def test_every_command_without_arguments_in_every_state(state):
    for name, args in ALWAYS:
        check(state, name, args)


@cache
def left_alone(state):
    """The bytes written to the arm without a command."""
    return prepared(state).copy().go(40)


def check(state, name, args):
    asked = prepared(state).copy()
    asked.core.handle(Request(name, args, id=1), asked.t)
    after = asked.go(40)
    refused = [answer.error for answer in asked.answers if answer.request.id == 1 and answer.error]
    if refused:
        assert after == left_alone(state), refused


def standing(angles: Angles):
    points = SetPoints(Bench().core.setpoints.poses, LIMITS)
    motion = PalmMotion.at_rest(angles)
    points.stand(motion, points.poses.pose(angles, 0.0), 0.0)
    return points


def refusal(points, step, t, whole):
    try:
        points.jog(step, t, whole)
    except MotionError as error:
        return str(error)
    return ""


angles = st.tuples(*(st.floats(low, high) for low, high in LIMITS.angles))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(angles, st.tuples(st.floats(-180.0, 180.0), st.floats(-180.0, 180.0)))
def test_a_stepwise_jog_is_refused_at_the_first_step_or_executed_completely(begin, way_deg):
    """As `palmd ctl jog` sends it: an infeasible jog is not begun."""
    if sum(begin) > math.radians(171.0):
        return
    points = standing(begin)
    whole = tuple(map(math.radians, way_deg))
    t, first = 0.0, True
    before = points.target(0.0)
    for step_deg in jog_steps(*way_deg):
        step = tuple(map(math.radians, step_deg))
        refused = refusal(points, step, t, whole)
        if refused:
            assert first, f"refused half way: {refused}"
            for _ in range(CYCLES):
                t += CYCLE_S
                assert points.target(t) == before
                points.sent(t)
            return
        whole, first, t_next = None, False, t + JOG_EVERY_S
        while t < t_next:
            t += CYCLE_S
            points.target(t)
            points.sent(t)
