"""For all tests: linear algebra has one thread, Ctrl-C means what it means at a terminal, none takes the processor."""

import gc
import os
import signal

import pytest
from hypothesis import HealthCheck, settings

from palmd.blas import one_thread_from_here

one_thread_from_here()  # as in every command: the threads of two workers would spin against each other

settings.register_profile("palmd", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("palmd")  # how long an example takes beside other work is none of a test's business

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts what runs in its background deaf to SIGINT, and that is handed on to every process that a test
    # starts and interrupts. What a handler catches, other programs begin with as usual.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """What thousands of tests are made of stays: no collection of garbage need look through it, now or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


@pytest.fixture(autouse=True)
def no_better_than_others():
    """A command that is run within a test may take real-time priority, and would keep it from the tests beside."""
    yield
    policy = os.sched_getscheduler(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    assert policy == os.SCHED_OTHER
