"""Pads and forces calibrated by a cylinder: real rig, daemon and command, a rig that is not as the daemon believes."""

import json
import subprocess
import sys

import pytest
import yaml
from harness import Client, Process, free_ports, wait

pytestmark = [pytest.mark.rig, pytest.mark.timeout(600)]

REAL = {
    "palm1": {"port": "pad1", "zero_mm": 26.5, "counts_per_mm": 8.11, "newtons_per_count": 0.024},
    "palm2": {"port": "pad2", "zero_mm": 29.2, "counts_per_mm": 7.65, "newtons_per_count": 0.017, "sign": -1},
}
LIMITS = {"phi1_deg": [20, 70], "phi2_deg": [70, 110]}


class Stand:
    """A rig with a cylinder on its palms, and a daemon that believes the defaults."""

    def __init__(self, folder):
        real, ports = folder / "REAL.yaml", folder / "ports"
        ports.mkdir()
        real.write_text(yaml.safe_dump({"pads": REAL, "arm": {"port": "arm"}, "limits": LIMITS}))
        self.rig = Process(folder, "rig", real, "--cylinder", "20,100", "--seed", "7", "--ports", ports)
        self.hand = Client(json.loads(self.rig.first_line())["control"])
        publish, command = (f"tcp://127.0.0.1:{port}" for port in free_ports(2))
        self.config = folder / "my.yaml"
        settings = {
            "pads": {f"palm{n}": {"port": str(ports / f"pad{n}")} for n in (1, 2)},
            "arm": {"port": str(ports / "arm")},
            "limits": LIMITS,
            "observer": {"primary": "quasistatic"},  # the least work: none is needed
            "bus": {"publish": publish, "command": command},
        }
        self.config.write_text(yaml.safe_dump(settings))
        self.daemon = Process(folder, "run", self.config, "--no-record")
        self.client = Client(command)

    def _ready(self):
        def ready():
            status = self.client.do("status")
            if status["state"] == "fault":
                self.client.ask("reset")
            elif status["state"] in ("tracking", "hold"):
                self.client.ask("stop")
            return status["state"] == "ready" and status["arm_state"] == "R"

        wait(ready, "a daemon that is ready", pause_s=0.2)

    def calibrated(self, name, *arguments):
        """What the command stored; an operator goes on after a hold for which the machine is to blame."""
        self._ready()
        command = [sys.executable, "-P", "-m", "palmd", "calibrate", name, self.config, "--radius-mm", "20"]
        with subprocess.Popen([*map(str, command), *arguments], stdout=-1, stderr=-1, text=True) as process:
            while process.poll() is None:
                if self.client.do("status")["state"] == "hold":
                    self.client.ask("start")
                try:
                    out, err = process.communicate(timeout=0.5)
                except subprocess.TimeoutExpired:
                    continue
        assert process.returncode == 0, err
        assert f"{self.config}: write in pads.palm2: " in out
        return yaml.safe_load((self.config.parent / f"calibration/{name}.yaml").read_text())

    def close(self):
        for each in (self.client, self.hand):
            each.close()
        for each in (self.daemon, self.rig):
            each.kill()


@pytest.fixture(scope="module")
def stand(tmp_path_factory):
    stand = Stand(tmp_path_factory.mktemp("cylinder"))
    yield stand
    stand.close()


def test_pads_that_are_not_as_configured_are_found(stand):
    found = stand.calibrated("pads")["configuration"]
    for palm, real in REAL.items():
        assert found[palm]["zero_mm"] == pytest.approx(real["zero_mm"], abs=0.05)
        assert found[palm]["counts_per_mm"] == pytest.approx(real["counts_per_mm"], rel=0.003)
        assert found[palm]["sign"] == real.get("sign", 1)
    assert stand.hand.do("status")["setpoints_outside_limits"] == 0


def test_forces_that_are_20_percent_off_are_found(stand):
    found = stand.calibrated("force", "--mass-g", "100", "--rounds", "2")["configuration"]
    for palm, real in REAL.items():
        expected = pytest.approx(real["newtons_per_count"], rel=0.08)  # two rounds of eight: four times the pads' drift
        assert found[palm]["newtons_per_count"] == expected
