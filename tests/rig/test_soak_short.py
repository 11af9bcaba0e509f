"""The study soak in short form: 30 s with real processes; slopes and lateness are not judged."""

import json

import pytest
from harness import run_study

pytestmark = [pytest.mark.rig, pytest.mark.timeout(600)]

SEED = 170


def soaked(folder):
    """Exit status, the acts, and the findings by name."""
    done = run_study("soak", "--seconds", "25", "--seed", SEED, "-o", folder, timeout_s=150)
    rows = [json.loads(line) for line in (folder / "soak.jsonl").read_text().splitlines()]
    findings = {row["name"]: row for row in rows if row["row"] == "finding"}
    return done.returncode, [row for row in rows if row["row"] == "doing"], findings


@pytest.mark.nightly
def test_half_a_minute_of_soak_meets_every_judged_goal(tmp_path):
    status, done, findings = soaked(tmp_path / "soak")
    assert [name for name, row in findings.items() if row["met"] is False] == []
    assert status == 0
    assert sum(row["what"] == "trick" for row in done) > 3
    assert findings["messages"]["value"] > 1000
    assert findings["ticks replayed"]["value"] > 1000
    assert {row["group"] for row in findings.values()} == {"leak", "lateness", "recording", "behaviour"}
