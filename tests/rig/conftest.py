"""Benches: one shared by a module's tests, or one for a test alone. Nothing of them is left.

The rig is emulated in real time, so these tests need the machine. They go before other work where this user may ask for
that. One that fails while others kept the processors waits for a quieter moment and is tried again; one that fails on a
machine that had time for it has failed. Beside all other tests there is no quieter moment to wait for, and
`tools/run_tests.py` tries again in the end.
"""

import contextlib
import os
import sys

import patience
import pytest
from _pytest.runner import runtestprotocol
from harness import LEAST_WORK, Bench

TRIES = 1 if os.environ.get("PALMD_TESTS_BESIDE") else 4
TRY_S, WAIT_S = 120.0, 60.0
_NICE = -10
_MISTAKES = ("AttributeError", "ImportError", "ModuleNotFoundError", "NameError", "SyntaxError", "TypeError")


@pytest.fixture(scope="session", autouse=True)
def _before_others():
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)


def pytest_collection_modifyitems(items):
    """A test's time is that of one try."""
    for item in items:
        if item.get_closest_marker("rig") is not None:
            own = item.get_closest_marker("timeout")
            seconds = own.args[0] if own else TRY_S
            item.add_marker(pytest.mark.timeout(TRIES * (seconds + WAIT_S)), append=False)


def _from_want_of_time(report):
    """Whether a test has failed in a way that more time might have mended; a mistake in its code it does not."""
    crash = getattr(report.longrepr, "reprcrash", None)
    return report.failed and not (crash and crash.message.startswith(_MISTAKES))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    """Try again what failed beside other work; only the last try is reported."""
    if item.get_closest_marker("rig") is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for left in reversed(range(TRIES)):
        pressure = patience.Pressure()
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        if not left or pressure.share() < patience.BUSY_SHARE or not any(map(_from_want_of_time, reports)):
            break
        print(f"\n{item.nodeid}: tried again: others keep the processors", file=sys.__stderr__)
        patience.until_quiet(WAIT_S)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _bench(folder, **changes):
    bench = Bench(folder, **changes)
    yield bench
    bench.close()


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A daemon on a rig, shared: a test leaves it in any state, and takes it from any."""
    yield from _bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture
def own_bench(tmp_path):
    """A daemon on a rig that nobody else uses."""
    yield from _bench(tmp_path)


@pytest.fixture
def light_bench(tmp_path):
    """The same, for a test to which its observer does not matter."""
    yield from _bench(tmp_path, **LEAST_WORK)
