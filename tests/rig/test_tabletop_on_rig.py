"""Pads of every kind and servos as processes on pseudo-terminals: doctor, the daemon, a palm that moves."""

import json
import subprocess
import sys
import time

import pytest
import yaml
from harness import Client, Process

pytestmark = pytest.mark.rig

ARRAY = {"kind": "taxels", "columns": 4, "zero_mm": 1.0}
PADS = {
    "strip": {"kind": "strip"},
    "evdev": {"kind": "evdev", "zero_mm": 0.0, "counts_per_mm": 20.0},
    "tsf85": ARRAY | {"protocol": "tsf85", "rows": 14, "pitch_mm": 4.5},
    "st0001": ARRAY | {"protocol": "st0001", "rows": 15, "pitch_mm": 4.0},
    "text": ARRAY | {"protocol": "text", "rows": 20, "pitch_mm": 3.0, "baud": 1000000},
}
MODELS = {"dynamixel": "XL430-W250, firmware 46", "feetech": "STS3215, firmware 3"}
RIGS = [
    ("strip", "dynamixel"),
    ("evdev", "dynamixel"),
    ("tsf85", "dynamixel"),
    ("st0001", "feetech"),
    ("text", "feetech"),
]


class Rig:
    """The emulated rig with pads of a kind, and a configuration of its ports."""

    def __init__(self, folder, pads, servos):
        def settings(ports):
            each = {f"palm{i}": PADS[pads] | {"port": ports[f"pad{i}"]} for i in (1, 2)}
            return {"rig": {"hinge": "fixed"}, "pads": each, "arm": {"kind": servos, "port": ports["arm"]}}

        self.servos = servos

        file = folder / "rig.yaml"
        file.write_text(yaml.safe_dump(settings({"pad1": "a", "pad2": "b", "arm": "c"})))
        self._process = Process(["rig", file, "--seed", 3], folder)
        self.found = json.loads(self._process.first_line())
        self.bus = {"publish": f"ipc://{folder}/publish", "command": f"ipc://{folder}/command"}
        self.config = folder / "palmd.yaml"
        self.config.write_text(yaml.safe_dump(settings(self.found) | {"bus": self.bus}))

    def close(self):
        self._process.stop()


@pytest.fixture(params=RIGS, ids="-".join)
def rig(tmp_path, request):
    rig = Rig(tmp_path, *request.param)
    yield rig
    rig.close()


def until(client, holds, patience_s=60.0):
    """The daemon's status once it is so."""
    t_end = time.monotonic() + patience_s
    while time.monotonic() < t_end:
        reply = client.ask("status")
        if reply["ok"] and holds(reply["result"]):
            return reply["result"]
        time.sleep(0.05)
    raise AssertionError(f"not within {patience_s:g} s: {reply}")


def test_the_daemon_arms_jogs_and_stops(rig, tmp_path):
    folder = tmp_path / "daemon"
    folder.mkdir()
    daemon = Process(["run", rig.config, "--no-record"], folder)
    client = Client(rig.bus["command"])
    try:
        until(client, lambda status: status["state"] == "ready", 240.0)
        assert client.ask("arm")["ok"]
        until(client, lambda status: status["state"] == "tracking" and status["arm_state"] == "T")
        assert client.ask("jog", phi1_deg=0.5)["ok"]
        assert client.ask("stop")["ok"]
        status = until(client, lambda status: status["state"] == "ready" and status["arm_state"] == "R")
        assert status["arm_error"] == ""
    finally:
        client.close()
        daemon.stop()


def test_doctor_finds_pads_and_servos(rig):
    done = subprocess.run(
        [sys.executable, "-P", "-m", "palmd", "doctor", str(rig.config)],
        capture_output=True, text=True, timeout=100, check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    assert "Traceback" not in done.stderr
    assert "ok           pad 1 port" in done.stdout
    assert "reports in" in done.stdout, "the object lies on both pads"
    assert MODELS[rig.servos] in done.stdout
    assert "one servo has id 2" in done.stdout
