"""`palmd demo` as a process: it ends with the right status in every case and leaves nothing behind."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest
import zmq

from palmd.bus.link import COMMAND, PUBLISH
from palmd.record.run import read_run

pytestmark = pytest.mark.rig

SUMMARY = re.compile(
    r"palmd demo: seed 3, shape observer settled after \d+\.\d s, object \d+ "
    r"(?:valid|not valid \(last valid \d+\.\d s before\)) at the end, "
    r"lost (?:never|once|\d+ times), outline \d+ µm RMS \(\d+\.\d\d%\) on \d+% touched "
    r"normals \(sd \d+ µm\), whole outline within \d+\.\d{3} mm \(largest sd \d+\.\d{3} mm\), r \d\.\d{3} mm, "
    r"omega0 \d\.\d{3} rad/s, "
    r"rho [+-]\d+\.\d%, mu \d\.\d\d \(true \d\.\d\d\), mass [+-]\d+\.\d%, ticks \d+, late > 2 ms \d+\.\d\d%, "
    r"work p99 \d+\.\d ms, rig with residual calibration errors"
    r"(, which got no processor time (?:once|\d+ times), \d+\.\d\d s in total)?\n"  # printed if the machine was busy
)


class Demo:
    """The command, marked so that all its processes can be found, with its own folder for temporary files.

    It runs in the folder `here`.
    """

    def __init__(self, folder, here, *arguments):
        self._mark, self._folder, self.here = f"PALMD_TEST={uuid.uuid4()}", folder, here
        self._said = ""
        name, value = self._mark.split("=")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "palmd", "demo", "--no-browser", *arguments],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=self.here,
            env=os.environ | {name: value, "TMPDIR": str(self._folder)},
        )  # fmt: skip

    def wait_for(self, text):
        """Waits until a line of standard error contains the text."""
        for line in self.process.stderr:
            self._said += line
            if text in line:
                return
        raise AssertionError(f"it ended without {text!r}")

    def end(self):
        """Status and output after it has ended; checks that nothing is left."""
        out, err = self.process.communicate(timeout=60)
        assert "Traceback" not in self._said + err
        assert self.processes() == {}
        assert list(self._folder.iterdir()) == []
        return self.process.returncode, out, self._said + err

    def processes(self):
        """Its living processes: command line by number."""
        found = {}
        for entry in Path("/proc").iterdir():
            with contextlib.suppress(OSError):
                if entry.name.isdigit() and self._mark.encode() in (entry / "environ").read_bytes():
                    found[int(entry.name)] = (entry / "cmdline").read_bytes().decode().split("\0")
        return found

    def child(self, command):
        """Number of the process that runs this command; forked copies with the same line are excluded."""
        return min(number for number, line in self.processes().items() if command in line)


@pytest.fixture
def demo(tmp_path, tmp_path_factory):
    started = []

    def start(*arguments):
        started.append(Demo(tmp_path, tmp_path_factory.mktemp("here"), *arguments))
        return started[-1]

    yield start
    for each in started:
        each.process.kill()
        each.process.communicate()
        for number in each.processes():
            os.kill(number, signal.SIGKILL)


@pytest.fixture
def busy_defaults():
    """Occupies the default addresses, unless they are occupied already."""
    with zmq.Context() as context, contextlib.ExitStack() as stack:
        for address in (PUBLISH, COMMAND):
            with contextlib.suppress(zmq.ZMQError):
                stack.enter_context(context.socket(zmq.PUB)).bind(address)
        yield


@pytest.mark.usefixtures("busy_defaults")
def test_it_runs_beside_busy_ports_and_ends_on_request_with_a_summary(demo):
    running = demo("--seed", "3")
    running.wait_for(" mm  rho ")
    running.process.send_signal(signal.SIGINT)
    status, out, err = running.end()
    assert (status, bool(SUMMARY.fullmatch(out))) == (0, True), out + err
    assert "palmd top --address tcp://127.0.0.1:" in err
    assert re.search(r" \d s  tracking", err), err  # unchanged status is not repeated within 10 s
    (path,) = (running.here / "runs").iterdir()
    assert f"recorded in {path}\n" in err
    run = read_run(path)
    assert run.complete
    survey = run.survey()
    assert {"palm/events", "palm/estimate", "rig/truth", "rig/object"} <= set(survey)
    assert all(found.missing == 0 for found in survey.values())
    assert survey["palm/estimate"].first == 0
    check = subprocess.run(
        [sys.executable, "-m", "palmd", "replay", str(path), "--check"], capture_output=True, text=True
    )
    assert check.returncode == 0, check.stdout + check.stderr  # the replay repeats the live estimates bit for bit


def test_it_ends_early_without_an_estimate_and_records_only_on_request(demo):
    running = demo("--seed", "3", "--no-record")
    running.wait_for("0 s  tracking")
    running.process.send_signal(signal.SIGTERM)
    status, out, _ = running.end()
    assert status == 3
    assert "shape observer never settled" in out
    assert not list(running.here.iterdir())


@pytest.mark.parametrize("child", ["run", pytest.param("rig", marks=pytest.mark.nightly)])
def test_it_reports_the_death_of_a_child(demo, child):
    running = demo("--seed", "3")
    running.wait_for("0 s  tracking")
    os.kill(running.child(child), signal.SIGKILL)
    status, out, err = running.end()
    assert (status, out) == (3, "")
    assert f"{child} ended with status -9" in err


def test_its_children_end_with_it(demo):
    running = demo("--seed", "3")
    running.wait_for("PlotJuggler")
    assert len(running.processes()) >= 3  # itself, the rig, the daemon, and possibly the daemon's smoother
    running.process.kill()
    running.process.wait()
    deadline = time.monotonic() + 10.0
    while running.processes():
        assert time.monotonic() < deadline, running.processes()
        time.sleep(0.05)


def test_invalid_configurations_are_reported_with_their_exit_status(demo, tmp_path_factory):
    config = tmp_path_factory.mktemp("config") / "bad.yaml"
    config.write_text("pads: {palm1: {port: a}, palm2: {port: b}}\narm: {port: c}\nplan: none.yaml\n")
    status, _, err = demo("--config", str(config), "--seed", "1").end()
    assert status == 1
    assert "none.yaml" in err


def test_mujoco_moves_the_object_until_the_demo_ends_by_itself(demo):
    pytest.importorskip("mujoco", reason="mujoco is not installed: the extra `mujoco` has it")
    begun = time.monotonic()
    running = demo("--physics", "mujoco", "--seconds", "4", "--seed", "2", "--no-record")
    status, out, err = running.end()
    assert time.monotonic() - begun > 4.0
    assert status in (0, 3), out + err  # depends on processor time
    assert out.startswith("palmd demo: seed 2, "), err
    assert "rig with residual calibration errors in MuJoCo" in out
    deepest = re.search(r"deepest penetration in MuJoCo: (\d\.\d) µm\n", err)
    assert deepest, err
    assert 0.0 < float(deepest[1]) < 2.0
