"""Benches, one shared by the tests of a module or one for a single test; both clean up completely.

The rig is emulated in real time, so these tests need the machine; they take priority over other work where the user
may. A test that fails while other programs used the processors is repeated at a quieter moment; a failure on an idle
machine counts. Beside all other tests there is no quiet moment, and `tools/run_tests.py` repeats the failures at the
end.
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
    """The time limit of a test applies to each try."""
    for item in items:
        if item.get_closest_marker("rig") is not None:
            own = item.get_closest_marker("timeout")
            seconds = own.args[0] if own else TRY_S
            item.add_marker(pytest.mark.timeout(TRIES * (seconds + WAIT_S)), append=False)


def _from_want_of_time(report):
    """Whether a lack of processor time may explain the failure; it does not explain an error in the test's code."""
    crash = getattr(report.longrepr, "reprcrash", None)
    return report.failed and not (crash and crash.message.startswith(_MISTAKES))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    """Repeats tests that failed beside other work; only the last try is reported."""
    if item.get_closest_marker("rig") is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for left in reversed(range(TRIES)):
        pressure = patience.Pressure()
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        if not left or pressure.share() < patience.BUSY_SHARE or not any(map(_from_want_of_time, reports)):
            break
        print(f"\n{item.nodeid}: repeated: other programs use the processors", file=sys.__stderr__)
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
    """A shared daemon on a rig; tests may start from and leave any state."""
    yield from _bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture
def light_bench(tmp_path):
    """A bench with the cheapest observer, for tests that do not depend on it."""
    yield from _bench(tmp_path, **LEAST_WORK)
