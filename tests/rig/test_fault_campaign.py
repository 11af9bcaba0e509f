"""The study faults in short form: a pad, an address and another process, with real processes.

`palmd why` is asked about the recordings.
"""

import json

import pytest
from harness import run_study

pytestmark = pytest.mark.rig

ADEPT = ("pad1-mute", "address-taken", "page-killed")


@pytest.mark.parametrize(
    ("rig", "names"),
    [
        ("adept", ADEPT),
        # `tests/unit/harness/test_tabletop.py` tests these without processes
        pytest.param("tabletop", ("pad1-mute", "servo-hot"), marks=pytest.mark.nightly),
        pytest.param("input", ("pad1-mute", "pad2-overflow"), marks=pytest.mark.nightly),
    ],
    ids=["adept", "tabletop", "input"],
)
def test_some_faults(tmp_path, rig, names):  # a short name, because it is part of a socket's path
    done = run_study("faults", "--rig", rig, "--only", *names, "-o", tmp_path, timeout_s=100)
    lines = [json.loads(line) for line in (tmp_path / "runs.jsonl").read_text().splitlines()]
    assert {line["name"]: line["differs"] for line in lines} == {name: [] for name in names}, done.stderr
    judged = [line["why"] for line in lines if not line["why"]["spoilt"]]
    assert [verdict for verdict in judged if not verdict["right"]] == []
    assert len(judged) >= len(names) // 2, "a busy machine may disturb a few rows only"
    assert done.returncode == 0
    assert f"{len(names)} of {len(names)} rows did as promised" in done.stdout
