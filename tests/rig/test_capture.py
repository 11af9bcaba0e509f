"""The guided first recording on the emulated rig, from the first check to the comparison with calipers."""

import json

import pytest
import yaml
from harness import palmd

from palmd.record.calipers import read_table
from palmd.yamlfile import load_config

pytestmark = [pytest.mark.rig, pytest.mark.timeout(1800)]

PLAN = {
    "name": "short",
    "segments": [
        {"move": {"phi1_deg": 45, "phi2_deg": 90}, "duration_s": 1.0},
        {"sine": {"phi1_deg": 16, "phi2_deg": 8}, "frequency_hz": [0.7, 0.55], "duration_s": 8.0},
    ],
}
OWN_TIME_S = 15 * 60


@pytest.mark.nightly
def test_capture_leads_from_the_check_to_bundle_and_comparison(tmp_path):
    plan, bundle = tmp_path / "short.yaml", tmp_path / "bundle"
    plan.write_text(yaml.safe_dump(PLAN))
    how = ("--emulated", "--seed", 3, "--objects", 1, "--plan", plan, "-o", bundle, "--zip")
    done = palmd("record", "capture", *how, timeout_s=OWN_TIME_S)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(tmp_path / "bundle.zip")
    config = load_config(bundle / "palmd.yaml")
    found = yaml.safe_load((bundle / "calibration/standoff.yaml").read_text())["configuration"]
    assert config.pads.palm1.zero_mm == found["palm1"]["zero_mm"] != 2.5
    assert "ok" in (bundle / "doctor.txt").read_text()
    (row,) = read_table(bundle)
    assert 20.0 < row.smallest_mm <= row.largest_mm < 60.0
    scored = palmd("reconstruct", bundle, "-o", tmp_path / "result.json", timeout_s=OWN_TIME_S)
    assert scored.returncode == 0, scored.stderr
    result = json.loads((tmp_path / "result.json").read_text())
    assert [each["object"] for each in result["objects"]] == [row.name]
    assert result["beyond_3_sigma"] == 0
