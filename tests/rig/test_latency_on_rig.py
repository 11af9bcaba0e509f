"""`palmd doctor latency` measures every case and leaves nothing behind."""

import os
import subprocess
import sys

import pytest

from palmd.doctor.latency import CASES

pytestmark = pytest.mark.rig


def test_every_case_has_its_line(tmp_path):
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-m", "palmd", "doctor", "latency", "--seconds", "2"],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    table, advice = done.stdout.split("\n\n", 1)
    assert "->" in advice
    head, *lines = table.splitlines()
    assert "late: p50" in head
    assert [line.partition("  ")[0] for line in lines] == list(CASES)
    for line, name in zip(lines, CASES, strict=True):
        ticks, _, *times = line.removeprefix(name).split()
        assert int(ticks) > 0
        assert "-" not in times
    assert list(tmp_path.iterdir()) == []
