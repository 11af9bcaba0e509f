"""Measurement of a marble on the emulated rig's pad by the real command, through the serial line."""

import pytest
import yaml
from harness import LoneRig, palmd

pytestmark = pytest.mark.rig


@pytest.fixture
def rig(tmp_path):
    """A rig with a marble on its first pad only."""
    rig = LoneRig(tmp_path, {}, "--marble", 1, "--seed", 5)
    yield rig
    rig.stop()


def test_a_pad_is_characterised_through_the_serial_line(rig):
    done = palmd("calibrate", "pad", rig.config, "--pad", 1, "--seconds", 4)
    assert done.returncode == 0, done.stderr
    result = yaml.safe_load((rig.config.parent / "calibration/pad1.yaml").read_text())
    found = result["found"]
    assert (found["x"]["step_counts"], found["y"]["step_counts"]) == (1, 1)
    assert 0.07 < found["x"]["noise_mm"] < 0.2  # 0.1 mm, and jitter of time stamps on a busy machine
    assert 0.2 < found["y"]["noise_mm"] < 0.35
    assert 8.0 < found["interval_mean_ms"] < 14.0
    assert [band["packet_times"] for band in found["bands"]] == [1, 2, 3]
    assert found["received_bytes"] >= 6 * found["reports"] > 900
    assert found["out_of_range"] == 0
    assert (rig.config.parent / "calibration/pad1.svg").exists()
    assert rig.end() == 0
