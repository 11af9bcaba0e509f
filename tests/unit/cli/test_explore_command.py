"""`palmd ctl explore` against the daemon's own sockets: its sequence of requests, its output, its end."""

import os
import signal
import threading
from contextlib import contextmanager

import pytest
import yaml
from bus_daemon import bus_daemon
from waiting import wait

from palmd.cli import main
from palmd.cli.explore import concluded, progress
from palmd.config.two_palms import PlanSpec
from palmd.daemon.commands import Reply
from palmd.harness import operator
from palmd.quantities import SHAPE


class Daemon:
    """Answers as palmd would: ready until armed; explores for a number of status requests."""

    def __init__(self, looks=3, armed=False, refuses=(), fault_at=None, held_at=None):
        self.state = "tracking" if armed else "ready"
        self.asked, self.plan = [], None
        self._looks, self._refuses, self._fault_at, self._held_at = looks, refuses, fault_at, held_at
        self._seen = None  # status requests since the start

    def answer(self, request):
        name = request.name
        if name != "status":
            self.asked.append(name)
        if name in self._refuses:
            return Reply(request, f"{name} refused: the state is\n{self.state}")
        match name:
            case "plan":
                self.plan = yaml.safe_load(request.args["text"])
            case "arm":
                self.state = "tracking"
            case "start":
                self._seen = 0
            case "hold":
                self.state = "hold"
            case "stop":
                self.state = "ready"
            case "status":
                return Reply(request, None, self.status())
        return Reply(request, None, {"state": self.state})

    def status(self):
        if self._seen is not None:
            self._seen += 1
            if self._seen == self._fault_at:
                self.state = "fault"
            if self._seen == self._held_at:
                self.state = "hold"
        going = self._seen is not None and self._seen <= self._looks
        grave = {"fault": "stop", "hold": "hold"}.get(self.state)
        return {
            "state": self.state, "cause": "stop was requested", "moving": False,
            "over": self._seen is not None and not going,
            "faults": ["explorer-silent", *(["pad1-lifted"] if grave else [])],
            "severities": ["note", *([grave] if grave else [])],
            "hints": ["-", *(["put the object back"] if grave else [])],
            "explored": {"coverage": 0.5 if going else 0.96, "reachable": 0.9,
                         "reason": "" if going else "96% of what can be reached is touched"},
        }  # fmt: skip


@contextmanager
def serving(folder, daemon):
    """The daemon at its sockets; the addresses as command-line arguments."""

    def shape(bus):
        bus.publish(SHAPE, {"h_sd_m": [1e-5, 4.2e-5, 2e-5]}, 0.0, 0.0)

    with bus_daemon(folder, daemon.answer, shape) as (publish, command):
        yield ["--address", command, "--listen", publish]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(operator, "LOOK_S", 0.02)
    monkeypatch.setattr(operator, "PROGRESS_S", 0.0)


def test_it_arms_starts_reports_progress_and_restores_the_arms_state(tmp_path, capsys):
    daemon = Daemon()
    with serving(tmp_path, daemon) as where:
        assert main(["ctl", "explore", *where, "--coverage", "0.9", "--band-mm", "0.05", "--seconds", "30"]) == 0
    assert daemon.asked == ["plan", "arm", "start", "stop"]
    spec = PlanSpec.model_validate(daemon.plan)
    goal = spec.segments[-1].explore
    assert (len(spec.segments), goal.coverage, goal.band_mm, goal.time_limit_s) == (1, 0.9, 0.05, 30.0)
    out, err = capsys.readouterr()
    assert out.startswith("explored 96% of the 90% of the outline that can be reached in 0 s, largest sd 0.042 mm: ")
    assert out.endswith(": 96% of what can be reached is touched\n")
    assert "tracking  touched 50%" in err


def test_an_arm_that_was_tracking_keeps_tracking(tmp_path):
    daemon = Daemon(armed=True)
    with serving(tmp_path, daemon) as where:
        assert main(["ctl", "explore", *where]) == 0
    assert daemon.asked == ["plan", "start"]


@pytest.mark.parametrize(
    ("command", "asked"),
    [("plan", ["plan"]), ("arm", ["plan", "arm"]), ("start", ["plan", "arm", "start", "hold", "stop"])],
)
def test_a_refusal_is_the_daemons_own_message_in_one_line(tmp_path, capsys, command, asked):
    daemon = Daemon(refuses=(command,))
    with serving(tmp_path, daemon) as where:
        assert main(["ctl", "explore", *where]) == 1
    assert daemon.asked == asked
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"{command} refused: the state is ")


def test_a_fault_ends_the_command_with_the_status_of_a_rig_failure(tmp_path, capsys):
    daemon = Daemon(looks=1000, fault_at=4)
    with serving(tmp_path, daemon) as where:
        assert main(["ctl", "explore", *where]) == 3
    err = capsys.readouterr().err.splitlines()[-1]
    assert "explored 50% of the 90%" in err
    assert "pad1-lifted: put the object back" in err
    assert daemon.asked[-1] == "stop"


def test_a_hold_is_reported_and_abandoned_after_a_timeout(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(operator, "HELD_S", 0.3)
    daemon = Daemon(looks=1000, held_at=3)
    with serving(tmp_path, daemon) as where:
        assert main(["ctl", "explore", *where]) == 3
    err = capsys.readouterr().err
    assert "pad1-lifted: put the object back (palmd ctl start continues)" in err
    assert "held for 0.3 s" in err
    assert daemon.asked[-2:] == ["hold", "stop"]


def test_ctrl_c_first_holds_and_then_stops(tmp_path, capsys):
    daemon = Daemon(looks=10**6, armed=True)

    def interrupt():
        wait(lambda: "start" in daemon.asked, "the order to start")
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    with serving(tmp_path, daemon) as where:
        thread.start()
        assert main(["ctl", "explore", *where]) == 0
        thread.join()
    assert daemon.asked == ["plan", "start", "hold", "stop"]
    assert capsys.readouterr().out.startswith("explored 50% of the 90%")


def test_progress_before_the_first_touch():
    status = {"state": "tracking", "explored": {"coverage": None, "reachable": None, "reason": "rocks the object"}}
    assert progress(status, 2.0, float("nan")).endswith("touched nothing yet  largest sd not known  rocks the object")
    assert "0.031 mm" in concluded(status, 2.0, 31e-6)
