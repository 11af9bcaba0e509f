"""Lateness and duration of the real daemon's ticks on the emulated rig, compared with cyclictest."""

import json
import math
import shutil
import signal
import subprocess
import sys
import time
from contextlib import ExitStack

import numpy as np
import pytest
from benchtable import PARTS, machine, percentiles, show

from palmd.bus.command_client import CommandClient
from palmd.bus.subscriber import Subscriber
from palmd.console.shipped import shipped
from palmd.daemon.realtime import PRIORITY
from palmd.harness.operator import Operator
from palmd.harness.processes import Child
from palmd.harness.stack import as_yaml, free_addresses
from palmd.yamlfile import load_config

pytestmark = [pytest.mark.bench, pytest.mark.timeout(180)]

SEED = 3
SECONDS = 20
PERIOD_MS = 10.0
WARM_UP_TICKS = 100
LATE_MS = 2.0

RECORDED_DAEMON = """
import sys
from array import array
from pathlib import Path
from palmd.daemon import app, loop

class Recorded(loop.LoopStatistics):
    rows = array("d")

    def tick(self, lateness_s, work_s, skipped):
        super().tick(lateness_s, work_s, skipped)
        self.rows.extend((lateness_s, work_s, skipped))

loop.LoopStatistics = Recorded
status = app.run(Path(sys.argv[1]))
Path(sys.argv[2]).write_bytes(Recorded.rows.tobytes())
sys.exit(status)
"""
"""The real daemon, with statistics that keep every tick."""


def start_rig(folder, stack):
    rig = Child(["rig", str(shipped("demo.yaml")), "--seed", str(SEED)], folder)
    stack.callback(rig.stop)
    return json.loads(rig.first_line(30.0) or rig.error_output())


def cyclictest(folder):
    """Wake-up latencies (ms) at the loop's priority and period; None with the reason if not measured."""
    if shutil.which("cyclictest") is None:
        return None, "no cyclictest: sudo apt-get install rt-tests"
    path = folder / "cyclictest.json"
    count = round(SECONDS * 1e3 / PERIOD_MS)
    run = subprocess.run(
        ["cyclictest", "-q", "-t1", "-m", f"-p{PRIORITY}", f"-i{PERIOD_MS * 1e3:.0f}", f"-l{count}", "-h100000",
         f"--json={path}"],
        capture_output=True, text=True,
    )  # fmt: skip
    if run.returncode != 0:
        return None, f"cyclictest cannot run: {(run.stderr or run.stdout).strip().splitlines()[-1]}"
    histogram = json.loads(path.read_text())["thread"]["0"]["histogram"]
    return np.repeat([int(us) * 1e-3 for us in histogram], list(histogram.values())), ""


def run_daemon(rig, folder, stack):
    """Lateness and work (ms) and skipped ticks of a run with moving palms, one row per tick."""
    config = load_config(shipped("demo.yaml")).model_copy(update={"plan": shipped("plans/lively.yaml")})
    bus = free_addresses(config.bus)
    path, ticks = folder / "palmd.yaml", folder / "ticks"
    path.write_text(as_yaml(config, bus, rig), encoding="utf-8")
    daemon = subprocess.Popen([sys.executable, "-c", RECORDED_DAEMON, str(path), str(ticks)], stderr=subprocess.PIPE)
    stack.callback(daemon.kill)
    subscriber = stack.enter_context(Subscriber(bus.publish, topics=("palm/state", "palm/motion")))
    client = stack.enter_context(CommandClient(bus.command, 5.0))
    operator, t_end = Operator(), math.inf
    t_give_up = time.monotonic() + 90.0  # the observer may have to be compiled first
    while time.monotonic() < min(t_end, t_give_up):
        for message in subscriber.until(time.monotonic() + 0.1):
            operator.take(message.topic, message.fields)
        assert daemon.poll() is None, daemon.stderr.read().decode()
        command = operator.decide(time.monotonic())
        if command and client.ask(command)["ok"] and command == "start":
            t_end = min(t_end, time.monotonic() + SECONDS)
    assert t_end < math.inf, "the palms did not start to move"
    daemon.send_signal(signal.SIGTERM)
    _, said = daemon.communicate(timeout=10.0)
    assert daemon.returncode == 0, said.decode()
    rows = np.frombuffer(ticks.read_bytes()).reshape(-1, 3)[WARM_UP_TICKS:]
    return rows[:, 0] * 1e3, rows[:, 1] * 1e3, rows[:, 2], b"no real-time priority" not in said


def test_bench_lateness_and_work_of_the_daemon(tmp_path):
    with ExitStack() as stack:
        rig = start_rig(tmp_path, stack)
        latency, why_not = cyclictest(tmp_path)
        lateness, work, skipped, realtime = run_daemon(rig, tmp_path, stack)
    rows = [("lateness", *percentiles(lateness)), ("work", *percentiles(work))]
    if latency is not None:
        rows.append(("cyclictest", *percentiles(latency)))
        pairs = zip(rows[0][1:], rows[2][1:], strict=True)
        rows.append(("lateness / cyclictest", *(mine / theirs for mine, theirs in pairs)))
    how = f"FIFO {PRIORITY}" if realtime else "no real-time priority"
    show(f"the daemon at {1e3 / PERIOD_MS:g} Hz against the emulated rig, seed {SEED}, {len(work)} ticks, {how} (ms)",
         PARTS, rows)  # fmt: skip
    late = np.mean(lateness > LATE_MS)
    print(f"  late by more than {LATE_MS:g} ms: {late:.2%} of ticks; skipped: {skipped.sum():.0f}")
    print(f"  {why_not or machine()}")
    assert percentiles(work)[0] < PERIOD_MS / 2
