"""A marble on the emulated rig's pad, measured through the wire by the real command."""

import json
import subprocess
import sys

import pytest
import yaml
from harness import Process

pytestmark = pytest.mark.rig


@pytest.fixture
def rig(tmp_path):
    """What the rig says of itself, a marble on its first pad only; and a configuration with its ports."""
    process = Process(["rig", "--marble", "1", "--seed", "5"], tmp_path)
    found = json.loads(process.first_line())
    config = tmp_path / "palmd.yaml"
    pads = {"palm1": {"port": found["pad1"]}, "palm2": {"port": found["pad2"]}}
    config.write_text(yaml.safe_dump({"pads": pads, "arm": {"port": found["arm"]}}))
    yield process, config
    process.stop()


def calibrate(config, *arguments):
    return subprocess.run(
        [sys.executable, "-P", "-m", "palmd", "calibrate", "pad", config, *arguments],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


def test_a_pad_is_characterised_through_the_wire(rig):
    process, config = rig
    done = calibrate(config, "--pad", "1", "--seconds", "4")
    assert done.returncode == 0, done.stderr
    result = yaml.safe_load((config.parent / "calibration/pad1.yaml").read_text())
    told = result["found"]
    assert (told["x"]["step_counts"], told["y"]["step_counts"]) == (1, 1)
    assert 0.07 < told["x"]["noise_mm"] < 0.2  # 0.1 mm, and what time stamps on a busy machine add
    assert 0.2 < told["y"]["noise_mm"] < 0.35
    assert 8.0 < told["interval_mean_ms"] < 14.0
    assert [band["packet_times"] for band in told["bands"]] == [1, 2, 3]
    assert told["received_bytes"] >= 6 * told["reports"] > 900
    assert told["out_of_range"] == 0
    assert (config.parent / "calibration/pad1.svg").exists()
    assert process.end() == 0
