"""Settings of all tests: one linear-algebra thread, default handling of Ctrl-C, no real-time priority."""

import gc
import os
import signal

import pytest
from hypothesis import HealthCheck, settings

from palmd.blas import one_thread_from_here

one_thread_from_here()  # as in every command: the threads of two workers would block each other

settings.register_profile("palmd", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("palmd")  # no deadline per example, because other work may run beside

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts its background processes with SIGINT ignored, and child processes inherit that. A handler is reset
    # to the default in new programs.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Freezes the objects of collection, so that the garbage collector does not scan them again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


@pytest.fixture(autouse=True)
def no_better_than_others():
    """Prevents commands inside tests from taking real-time priority over parallel tests."""
    yield
    policy = os.sched_getscheduler(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    assert policy == os.SCHED_OTHER
