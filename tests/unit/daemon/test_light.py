"""Processes of a rig stay small: none of them loads CasADi or SciPy, and the daemon's locked memory is bounded."""

import subprocess
import sys

import pytest

from palmd.model import rollout, sensitivity, shape_map, smoothing

PROCESSES = {
    "daemon": "palmd.daemon.app",
    "smoother": "palmd.daemon.smoothing",
    "explorer": "palmd.daemon.explorer_process",
    "recorder": "palmd.record.recorder",
    "page": "palmd.view.server",
    "rig": "palmd.rig.app",
}
HEAVY = "found = {'casadi', 'scipy', 'matplotlib', 'pandas'} & set(sys.modules); assert not found, found"
MOST_MB = 90.0

A_DAEMON = """
import palmd.daemon.app
from palmd import observer
from palmd.daemon import realtime
from palmd.system.description import RigDescription
watcher = observer.make("shape", RigDescription())
watcher.warm_up()
missing = realtime._lock_memory()
print(missing or "locked", realtime.rss_mb())
"""
A_SMOOTHER = """
from palmd.observer.reconstruct import reconstruct
from simulated import simulated
run = simulated("friction", 1, 3.0)
assert reconstruct(run.events, run.rig).h is not None
"""
AN_OFFLINE_COMMAND = """
import json
from pathlib import Path
from palmd.cli import main
log, said = Path({folder!r}, "log.jsonl"), Path({folder!r}, "said")
palms = [{{"t": 0.02 * k, "palms": {{"phi1_rad": 0.8, "phi2_rad": 1.5}}}} for k in range(5)]
pad = {{"length_m": 0.06, "noise_m": 1e-4, "resolution_m": 1e-4}}
rig = {{"gravity_m_s2": 9.8, "hinge": {{"mode": "fixed"}}, "pad": pad, "force_scale_std": 0.05}}
lines = [{{"palmd_log": 1, "rig": rig}}, *palms]
log.write_text("".join(json.dumps(each) + "\\n" for each in lines))
assert main([{name!r}, str(log), "-o", str(said)]) == 0
of_runs = {{"pydantic", "yaml", "mcap", "zmq"}} & set(sys.modules)
assert not of_runs, of_runs
"""
AN_EXPLORER = """
from test_explorer import STANDING, explorer, planning_belief
assert explorer().decide(planning_belief(), STANDING).kind == "move"
"""


@pytest.fixture(scope="module", autouse=True)
def built():
    """Builds the models first, because building needs CasADi."""
    for model in (shape_map, smoothing, sensitivity, rollout):
        assert model.library().backend == "c"
    assert shape_map.library(smoothing.ORDER).backend == "c"


def output_of(code, *folders):
    path = [str(each) for each in folders]
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\nsys.path[:0] = {path}\n{code}\n{HEAVY}"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("name", PROCESSES)
def test_no_process_loads_libraries_needed_only_for_building(name):
    output_of(f"import {PROCESSES[name]}")


@pytest.mark.parametrize("code", [A_SMOOTHER, AN_EXPLORER], ids=["smoother", "explorer"])
def test_working_processes_do_not_load_them_either(code, request):
    tests = request.config.rootpath / "tests"
    output_of(code, tests / "helpers", tests / "unit/motion")


@pytest.mark.parametrize("name", ["reconstruct", "estimate"])
def test_reading_an_event_log_loads_neither_configuration_nor_recording_modules(name, tmp_path):
    output_of(AN_OFFLINE_COMMAND.format(name=name, folder=str(tmp_path)))


def test_a_daemons_memory_is_bounded():
    how, _, rss_mb = output_of(A_DAEMON).strip().rpartition(" ")
    if how != "locked":
        pytest.skip(how)
    assert float(rss_mb) < MOST_MB
