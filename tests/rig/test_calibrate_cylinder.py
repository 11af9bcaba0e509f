"""Pads calibrated by a cylinder: real rig, daemon and command, on a rig that differs from the daemon's configuration.

Calibration of forces is alike and takes minutes; `tests/unit/calibration` tests it in virtual time.
"""

import subprocess
import sys

import pytest
import yaml
from harness import LEAST_WORK, Client, Process, free_ports, wait

from palmd.config.two_palms import Config
from palmd.harness.stack import Stack

pytestmark = [pytest.mark.rig, pytest.mark.timeout(600)]

REAL = {
    "palm1": {"port": "pad1", "zero_mm": 26.5, "counts_per_mm": 8.11, "newtons_per_count": 0.024},
    "palm2": {"port": "pad2", "zero_mm": 29.2, "counts_per_mm": 7.65, "newtons_per_count": 0.017, "sign": -1},
}
LIMITS = {"phi1_deg": [20, 70], "phi2_deg": [70, 110]}


class Stand(Stack):
    """A rig with a cylinder on its palms, and a daemon with the default configuration."""

    child = Process

    def __init__(self, folder):
        real = folder / "REAL.yaml"
        real.write_text(yaml.safe_dump({"pads": REAL, "arm": {"port": "arm"}, "limits": LIMITS}))
        ports = {"pads": {"palm1": {"port": "pad1"}, "palm2": {"port": "pad2"}}, "arm": {"port": "arm"}}
        publish, command = (f"tcp://127.0.0.1:{port}" for port in free_ports(2))
        bus = {"bus": {"publish": publish, "command": command}}
        believed = Config.model_validate(ports | bus | LEAST_WORK | {"limits": LIMITS})
        super().__init__(folder, believed)
        self.start_rig("--cylinder", "20,100", "--seed", "7", config=real)
        self.configure(believed, self.rig_info)
        self.begin_daemon()
        self.client = self._exit_stacks["daemon"].enter_context(Client(self.bus.command))

    def _ready(self):
        def ready():
            status = self.client.do("status")
            if status["state"] == "fault":
                self.client.ask("reset")
            elif status["state"] in ("tracking", "hold"):
                self.client.ask("stop")
            return status["state"] == "ready" and status["arm_state"] == "R"

        wait(ready, "a daemon that is ready", pause_s=0.2)

    def calibrated(self):
        """The stored calibration; the operator resumes after holds caused by the machine."""
        self._ready()
        command = [sys.executable, "-P", "-m", "palmd", "calibrate", "pads", self.path, "--radius-mm", "20"]
        with subprocess.Popen([*map(str, command)], stdout=-1, stderr=-1, text=True) as process:
            while process.poll() is None:
                if self.client.do("status")["state"] == "hold":
                    self.client.ask("start")
                try:
                    out, err = process.communicate(timeout=0.5)
                except subprocess.TimeoutExpired:
                    continue
        assert process.returncode == 0, err
        assert f"{self.path}: write in pads.palm2: " in out
        return yaml.safe_load((self.path.parent / "calibration/pads.yaml").read_text())


@pytest.mark.nightly
def test_pads_that_differ_from_the_configuration_are_calibrated(tmp_path):
    with Stand(tmp_path) as stand:
        found = stand.calibrated()["configuration"]
        for palm, real in REAL.items():
            assert found[palm]["zero_mm"] == pytest.approx(real["zero_mm"], abs=0.05)
            assert found[palm]["counts_per_mm"] == pytest.approx(real["counts_per_mm"], rel=0.003)
            assert found[palm]["sign"] == real.get("sign", 1)
        assert stand.rig_status()["setpoints_outside_limits"] == 0
