"""Plans compiled in a separate process: ordinary priority, bounds, restarts."""

import os
import pickle
import signal
import time
from functools import partial

import pytest
from waiting import wait

from palmd.daemon import plan_compiler
from palmd.daemon.plan_compiler import CompilationError, PlanCompiler, compiled
from palmd.daemon.planner import plan_in
from palmd.motion.check import motion_limits
from palmd.rig.world import default_config

LIMITS = motion_limits(default_config())
TEXT = "name: short\nsegments:\n- move: {phi1_deg: 40, phi2_deg: 95}\n  duration_s: 0.5\n"


@pytest.fixture
def compiler():
    one = PlanCompiler()
    yield one
    one.close()


def outcome(future):
    wait(lambda: future.done() or time.sleep(0.01), "the plan")
    return future


def asked(compiler, text=TEXT):
    return compiler.submit(partial(plan_in, text, "sent.yaml", LIMITS, None))


def test_a_plan_is_returned_and_obeys_the_callers_limits(compiler):
    plan = outcome(asked(compiler)).result().with_limits(LIMITS)
    assert plan.name == "short"
    assert plan.is_valid_for(LIMITS, (0.5, 1.5))


def test_errors_of_a_plan_are_reported_unchanged(compiler):
    with pytest.raises(CompilationError, match=r"sent.yaml:\d+:\d+: "):
        outcome(asked(compiler, TEXT.replace("95", "300"))).result()


def test_the_process_runs_at_ordinary_priority(compiler):
    number = compiler._process.number
    assert os.sched_getscheduler(number) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
    assert os.getpriority(os.PRIO_PROCESS, number) >= os.getpriority(os.PRIO_PROCESS, 0)


def test_a_plan_is_compiled_after_an_abandoned_one(compiler):
    compiler.submit(partial(time.sleep, 600.0))
    assert outcome(asked(compiler)).result().name == "short"


def test_a_stopped_process_is_restarted_and_gets_the_plan(compiler, monkeypatch):
    monkeypatch.setattr("palmd.daemon.worker.RESTART_S", 0.0)
    wait(lambda: compiler.tend(time.monotonic()) or compiler._process._t_heartbeat < 1e300, "a sign of life")
    os.kill(compiler._process.number, signal.SIGSTOP)
    future = asked(compiler)
    wait(lambda: compiler.tend(time.monotonic()) or future.done(), "the plan")
    assert future.result().name == "short"
    assert compiler._process.starts == 2


def spin():
    while True:
        pass


def test_compilation_time_and_plan_size_are_bounded(monkeypatch):
    monkeypatch.setattr(plan_compiler, "MAX_CPU_S", 0.05)
    before = signal.signal(signal.SIGPROF, plan_compiler._raise_timeout)
    try:
        number, packed, error = compiled(pickle.dumps((7, spin, (), {})))
    finally:
        signal.signal(signal.SIGPROF, before)
    assert (number, packed) == (7, b"")
    assert "processor time" in error
    _, packed, error = compiled(pickle.dumps((8, bytes, (plan_compiler.MAX_PLAN_BYTES + 1,), {})))
    assert (packed, "too large" in error) == (b"", True)


def test_many_long_sines_are_compiled(compiler):
    sine = "- sine: {phi1_deg: 5, phi2_deg: 4}\n  frequency_hz: [0.4, 0.31]\n  duration_s: 3600\n"
    text = TEXT + 199 * sine
    plan = outcome(asked(compiler, text)).result()
    assert plan.trajectory.duration == pytest.approx(199 * 3600.0, abs=1.0)
