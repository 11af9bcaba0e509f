"""`palmd bench soak`, its short form: half a minute with real processes, everything judged but slopes and lateness."""

import json

import pytest
from harness import Process

pytestmark = [pytest.mark.rig, pytest.mark.timeout(600)]

SEED = 170  # a lost port, damaged bytes on two lines, another object, a page


def soaked(folder):
    """Exit status, what was done and the findings by name."""
    folder.mkdir()
    process = Process(["bench", "soak", "--seconds", "25", "--seed", SEED, "-o", folder], folder)
    try:
        status = process.wait(150)
    finally:
        process.stop()
    rows = [json.loads(line) for line in (folder / "soak.jsonl").read_text().splitlines()]
    findings = {row["name"]: row for row in rows if row["row"] == "finding"}
    return status, [row for row in rows if row["row"] == "doing"], findings


def test_half_a_minute(tmp_path):
    status, done, findings = soaked(tmp_path / "soak")
    assert [name for name, row in findings.items() if row["met"] is False] == []
    assert status == 0
    assert findings["mischiefs"]["value"] >= sum(row["what"] == "trick" for row in done) > 3
    assert findings["pad1 packets decoded"]["value"] > 1000
    assert findings["set-points sent"]["value"] > 500
    assert findings["ticks replayed"]["value"] > 1000
    assert {row["group"] for row in findings.values()} == {"leak", "lateness", "counters", "recording", "behaviour"}
