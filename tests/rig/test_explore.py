"""Exploration with daemon, rig and explorer as processes, and recovery from the loss of the explorer."""

import os
import signal
from pathlib import Path

import pytest

pytestmark = pytest.mark.rig

PLAN = """\
name: explore
segments:
  - {move: {phi1_deg: 45, phi2_deg: 90}, duration_s: 0.8}
  - {explore: {coverage: 1.0, time_limit_s: 600}}
"""
GRAVE = ("hold", "stop")


def explore(bench):
    """Starts an exploration and waits for the first decisions."""
    bench.ready()
    plan = bench.folder / "explore.yaml"
    plan.write_text(PLAN)
    bench.client.do("plan", path=str(plan))
    bench.client.do("arm")
    bench.client.do("start")
    until(bench, lambda heard: heard.latest["palm/estimate"]["valid"], "a valid estimate from rocking")
    until(bench, lambda _: coverage(bench), "a decision")


def until(bench, condition, what):
    """As the bench's own; resumes after holds and faults caused by a slow machine."""
    bench.until(lambda heard: bench.restart_motion() or condition(heard), what)


def coverage(bench):
    """The published coverage, 0 before the first decision."""
    return bench.client.do("status").get("explored", {}).get("coverage") or 0.0


def explorer_number(bench):
    """The process number of the daemon's explorer."""
    daemon = bench.daemon.number
    children = Path(f"/proc/{daemon}/task/{daemon}/children").read_text(encoding="ascii").split()
    (number,) = (int(child) for child in children if b"explorer_process" in Path(f"/proc/{child}/cmdline").read_bytes())
    return number


def test_coverage_grows_from_a_start_without_estimate_and_stop_ends_it(bench):
    explore(bench)
    begun = coverage(bench)
    until(bench, lambda _: coverage(bench) > begun + 0.05, "more of the outline touched")
    if not bench.stalled():
        assert not [code for code, severity in bench.heard.faults.items() if severity in GRAVE]
    assert bench.motion["segment"] == 1
    assert bench.motion["progress"] > 0.05
    bench.client.do("stop")
    bench.until(lambda heard: heard.state == "ready" and bench.motion["arm_state"] == "R", "ready again")
    bench.at_rest()
    assert bench.client.do("status")["explored"]["reason"] == "it was stopped"
    bench.judge()


def test_a_stopped_explorer_is_replaced_and_the_palms_continue(bench):
    explore(bench)
    number, starts = explorer_number(bench), bench.heard.latest["palm/loop"]["explorer_starts"]
    os.kill(number, signal.SIGSTOP)
    until(bench, lambda heard: heard.latest["palm/loop"]["explorer_starts"] == starts + 1, "another explorer")
    assert bench.heard.state == "tracking"
    assert explorer_number(bench) != number
    bench.moving()
    bench.until_gone("explorer-silent")
    bench.judge()
