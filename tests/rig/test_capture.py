"""The guided first recording on the emulated rig, from its first check to the comparison with the calipers."""

import json
import subprocess
import sys

import pytest
import yaml

from palmd.console.shipped import shipped
from palmd.harness.stack import Stack
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


def palmd(*arguments):
    command = [sys.executable, "-P", "-m", "palmd", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, timeout=OWN_TIME_S
    )


def test_from_the_check_to_the_bundle_and_the_comparison(tmp_path):
    plan, bundle = tmp_path / "short.yaml", tmp_path / "bundle"
    plan.write_text(yaml.safe_dump(PLAN))
    done = palmd("capture", "--emulated", "--seed", 3, "--objects", 1, "--plan", plan, "-o", bundle, "--zip")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(tmp_path / "bundle.zip")
    config = load_config(bundle / "palmd.yaml")
    found = yaml.safe_load((bundle / "calibration/standoff.yaml").read_text())["configuration"]
    assert config.pads.palm1.zero_mm == found["palm1"]["zero_mm"] != 2.5
    assert "ok" in (bundle / "doctor.txt").read_text()
    (row,) = read_table(bundle)
    assert 20.0 < row.smallest_mm <= row.largest_mm < 60.0
    scored = palmd("reconstruct", bundle, "-o", tmp_path / "result.json")
    assert scored.returncode == 0, scored.stderr
    result = json.loads((tmp_path / "result.json").read_text())
    assert [each["object"] for each in result["objects"]] == [row.name]
    assert result["beyond_3_sigma"] == 0


class Watched:
    """A command that is answered on its standard input, line by line, and watched on its standard error."""

    def __init__(self, *arguments, answers):
        command = [sys.executable, "-P", "-m", "palmd", *map(str, arguments)]
        self._process = subprocess.Popen(command, stdin=-1, stdout=-1, stderr=-1, text=True, bufsize=1)
        self._process.stdin.write("".join(f"{answer}\n" for answer in answers))
        self._process.stdin.flush()
        self.said = ""

    def lines(self):
        for line in self._process.stderr:
            self.said += line
            yield line

    def ended(self):
        return self._process.wait(OWN_TIME_S), self._process.stdout.read().strip()


def test_a_person_at_the_rig_is_led_through_by_prompts(tmp_path):
    plan, bundle, config = (tmp_path / name for name in ("short.yaml", "bundle", "my.yaml"))
    plan.write_text(yaml.safe_dump(PLAN))
    with Stack(tmp_path, load_config(shipped("tabletop.yaml"))) as stack:
        stack.start_rig("--cylinder", "24,150", "--seed", "5")
        values = yaml.safe_load(shipped("tabletop.yaml").read_text()) | {"plan": str(plan)}
        ports = {f"palm{i}": values["pads"][f"palm{i}"] | {"port": stack.told[f"pad{i}"]} for i in (1, 2)}
        values |= {"pads": ports, "arm": values["arm"] | {"port": stack.told["arm"]}}
        config.write_text(yaml.safe_dump(values))
        answers = ("48", "none", "a disc", "disc", "48", "58", "48", "150", "")
        guide = Watched("capture", config, "--objects", 1, "-o", bundle, answers=answers)
        for line in guide.lines():
            if line.startswith("take "):
                stack.ask_rig("mischief", name="lift", for_s=5.0)
        status, printed = guide.ended()
    assert status == 0, guide.said
    assert printed == str(bundle)
    assert "one word of letters" in guide.said
    assert "a number from 1 to 48" in guide.said
    (row,) = read_table(bundle)
    assert (row.name, row.largest_mm, row.smallest_mm, row.mass_g) == ("disc", 48.0, 48.0, 150.0)
