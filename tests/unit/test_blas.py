"""One thread for linear algebra: in every process of palmd's own, and in others' while palmd computes."""

import json
import os
import subprocess
import sys
from collections import UserList
from pathlib import Path

import pytest
from simulated import simulated
from threadpoolctl import threadpool_info, threadpool_limits

from palmd.blas import one_thread
from palmd.cli.table import COMMANDS
from palmd.events import Estimate
from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import EventLog
from palmd.record.replay import replay
from palmd.rig.simulate import simulate_log
from tools.studies.stub_observers import EmptyObserver

MANY = 3
ASKED_FOR_MANY = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), str(MANY))

# The environment of a command's module at its import: whether there is an array library, and its number of threads.
EVERY_COMMAND = """
import importlib, json, os, sys, types
import palmd.cli.table

def found(name):
    print(json.dumps([name, "numpy" in sys.modules, os.environ["OPENBLAS_NUM_THREADS"]]))
    return types.SimpleNamespace(__doc__="", add_arguments=lambda parser: None, run=lambda arguments: 0)

importlib.import_module = found
for each in palmd.cli.table.COMMANDS:
    if each.module and each.name != "report paper":  # which takes its arguments from `report`
        os.environ["OPENBLAS_NUM_THREADS"] = "3"
        palmd.cli.main(each.name.split())
"""
REPORTING = """
import json, sys
def serve(*arguments):
    import numpy, scipy.linalg, threadpoolctl
    print(json.dumps([each["num_threads"] for each in threadpoolctl.threadpool_info()]))
"""


def in_effect():
    """The numbers of threads of all loaded libraries."""
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


@pytest.fixture
def many(monkeypatch):
    """A foreign program whose linear algebra uses several threads."""
    monkeypatch.setattr("palmd.blas._own_process", False)  # the tests themselves are a process of palmd's own
    with threadpool_limits(MANY):
        assert in_effect() == {MANY}
        yield
        assert in_effect() == {MANY}, "its threads were not restored"


class Watched(UserList):
    """Events that record the number of threads each time they are read."""

    def __init__(self, events):
        super().__init__(events)
        self.seen = set()

    def __iter__(self):
        self.seen |= in_effect()
        return iter(self.data)


class Watch(EmptyObserver):
    """An observer that only records the number of threads."""

    def __init__(self):
        self.seen = set()

    def feed(self, _event):
        self.seen |= in_effect()

    def estimate(self, t):
        self.seen |= in_effect()
        values = dict.fromkeys(Estimate.__dataclass_fields__, 0.5)
        return Estimate(**values | {"t": t, "valid": False, "observer": "watch", "object_count": 1, "sd": {}})

    def shape(self, _t):
        self.seen |= in_effect()


def test_every_command_begins_with_one_thread_whatever_the_environment():
    output = subprocess.run([sys.executable, "-c", EVERY_COMMAND], capture_output=True, text=True, check=True).stdout
    found = [json.loads(line) for line in output.splitlines()]
    assert found == [
        [f"palmd.{each.module}", False, "1"] for each in COMMANDS if each.module and each.name != "report paper"
    ]


def test_a_command_computes_with_one_thread(tmp_path):
    lines, _ = simulate_log("nominal", 3, 2.0)
    log = tmp_path / "log.jsonl"
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    program = (
        "import json, sys, threadpoolctl; from palmd.cli import main; status = main(sys.argv[1:]);"
        "print(json.dumps([each['num_threads'] for each in threadpoolctl.threadpool_info()])); sys.exit(status)"
    )
    command = [sys.executable, "-c", program, "reconstruct", log, "-o", tmp_path / "result.json"]
    done = subprocess.run(command, env=os.environ | ASKED_FOR_MANY, capture_output=True, text=True, check=True)
    assert set(json.loads(done.stdout)) == {1}


def test_a_process_beside_the_loop_has_one_thread(tmp_path):
    (tmp_path / "reporting.py").write_text(REPORTING)
    environment = os.environ | ASKED_FOR_MANY | {"PYTHONPATH": str(tmp_path)}
    with Path(os.devnull).open("w") as signs:
        number = signs.fileno()
        command = [sys.executable, "-m", "palmd.daemon.worker_main", "reporting", str(os.getpid()), str(number)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, pass_fds=[number])
    assert set(json.loads(done.stdout)) == {1}


@pytest.mark.usefixtures("many")
def test_reconstruct_uses_one_thread_and_restores_the_number():
    run = simulated("nominal", 3, 2.0)
    events = Watched(run.events)
    reconstruct(events, run.rig)
    assert events.seen == {1}


@pytest.mark.usefixtures("many")
def test_a_replay_uses_one_thread_and_restores_the_number_between_ticks():
    run = simulated("nominal", 3, 2.0)
    watch = Watch()
    between = set()
    for _ in replay(EventLog(run.rig, run.events), watch):
        between |= in_effect()
    assert watch.seen == {1}
    assert between == {MANY}


@pytest.mark.usefixtures("many")
def test_nested_limits_and_errors_restore_the_number_of_threads():
    with one_thread():
        with pytest.raises(ZeroDivisionError), one_thread():
            raise ZeroDivisionError
        assert in_effect() == {1}
