"""A marble on the emulated rig's pad, measured through the wire by the real command."""

import pytest
import yaml
from harness import LoneRig, palmd

pytestmark = pytest.mark.rig


@pytest.fixture
def rig(tmp_path):
    """A marble on its first pad only."""
    rig = LoneRig(tmp_path, {}, "--marble", 1, "--seed", 5)
    yield rig
    rig.stop()


def test_a_pad_is_characterised_through_the_wire(rig):
    done = palmd("calibrate", "pad", rig.config, "--pad", 1, "--seconds", 4)
    assert done.returncode == 0, done.stderr
    result = yaml.safe_load((rig.config.parent / "calibration/pad1.yaml").read_text())
    told = result["found"]
    assert (told["x"]["step_counts"], told["y"]["step_counts"]) == (1, 1)
    assert 0.07 < told["x"]["noise_mm"] < 0.2  # 0.1 mm, and what time stamps on a busy machine add
    assert 0.2 < told["y"]["noise_mm"] < 0.35
    assert 8.0 < told["interval_mean_ms"] < 14.0
    assert [band["packet_times"] for band in told["bands"]] == [1, 2, 3]
    assert told["received_bytes"] >= 6 * told["reports"] > 900
    assert told["out_of_range"] == 0
    assert (rig.config.parent / "calibration/pad1.svg").exists()
    assert rig.end() == 0
