"""A command whose output cannot be written keeps its exit status and prints no traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

GOOD = """\
rig: {hinge: arc}
pads: {palm1: {port: /dev/a}, palm2: {port: /dev/b}}
arm: {port: /dev/c}
"""
PALMD = [sys.executable, "-m", "palmd"]
FULL = Path("/dev/full")


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    path = tmp_path_factory.mktemp("lost") / "good.yaml"
    path.write_text(GOOD)
    return path


def shell(command, *arguments, **environment):
    done = subprocess.run(
        ["bash", "-c", command, "bash", *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "PALMD": " ".join(PALMD), **environment},
        check=False,
    )
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    return done


def test_standard_output_may_be_closed(good):
    assert shell('$PALMD check "$1" >&-', good).returncode == 0


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
def test_standard_output_may_be_full(good):
    done = shell('$PALMD check "$1" >/dev/full', good)
    assert done.returncode == 0
    assert "No space left on device" in done.stderr


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_standard_output_without_a_reader(good, unbuffered):
    command = '$PALMD check --json "$1" "$2" | true; exit ${PIPESTATUS[0]}'
    assert shell(command, good, good.with_name("none.yaml"), PYTHONUNBUFFERED=unbuffered).returncode == 1


def test_all_standard_streams_may_be_closed():
    assert shell("$PALMD check --bogus <&- >&- 2>&-").returncode == 2
