"""Running all tests: in parallel, none left out, and delayed rig tests repeated alone."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = """\
import os, pathlib, sys, time
log = pathlib.Path("log")
name, first, tries = sys.argv[1:4]
again = "--last-failed" in sys.argv
how = "collected" if "--collect-only" in sys.argv else "again" if again else "first"
with log.open("a") as stream:
    stream.write(f"{name} {how} {os.environ.get('PALMD_TESTS_BESIDE')}\\n")
print(f"{name} talks")
t_end = time.monotonic() + 30.0
while name == "slow" and "rig again" not in log.read_text() and time.monotonic() < t_end:
    time.sleep(0.02)
sys.exit(int(tries.split(",")[log.read_text().count(f"{name} again") - 1] if again else first))
"""


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.chdir(ROOT)
    spec = importlib.util.spec_from_file_location("run_tests", ROOT / "tools/run_tests.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def ran(tool, monkeypatch, tmp_path):
    """Exit status, and the runs of parts given as (name, status, status when repeated, whether of a rig)."""
    (tmp_path / "part.py").write_text(SCRIPT)
    monkeypatch.chdir(tmp_path)

    def run(*parts):
        made = [
            tool.Part(name, (sys.executable, "part.py", name, str(first), str(again)), rig=rig)
            for name, first, again, rig in parts
        ]
        monkeypatch.setattr(tool, "parts", lambda: made)
        status = tool.main([])
        return status, sorted(tuple(line.split()) for line in (tmp_path / "log").read_text().splitlines())

    return run


def test_a_rig_test_that_fails_beside_others_is_repeated_alone(ran, capfd):
    assert ran(("other", 0, 9, False), ("rig", 1, 0, True)) == (
        0,
        [("other", "first", "None"), ("rig", "again", "None"), ("rig", "first", "1")],
    )
    output = capfd.readouterr().out
    assert output.index("rig, after") < output.index("rig: repeating failed tests") < output.index("failed: nothing")
    assert "other talks" in output


@pytest.mark.parametrize(
    ("tries", "how", "status"), [("0", ["1"], 0), ("1,0", ["1", "None"], 0), ("1,1", ["1", "None"], 1), ("2", ["1"], 1)]
)
def test_it_is_first_repeated_at_once_while_others_run(ran, tries, how, status):
    """And alone only if it fails again."""
    found, log = ran(("rig", 1, tries, True), ("slow", 0, 9, False))
    assert found == status
    assert log == [*(("rig", "again", each) for each in how), ("rig", "first", "1"), ("slow", "first", "None")]


@pytest.mark.parametrize(
    "parts",
    [
        [("rig", 1, 1, True)],  # fails on the quiet machine too
        [("rig", 2, 0, True)],  # was not run to its end
        [("rig", 0, 0, True), ("other", 1, 0, False)],
    ],
)
def test_a_failed_part_fails_the_run(ran, parts, capfd):
    status, log = ran(*parts)
    assert status == 1
    assert len(log) == len(parts) + (parts[0][1] == 1)
    assert f"failed: {parts[-1][0]}" in capfd.readouterr().out


def test_no_test_is_left_out_and_none_is_run_twice(tool):
    parts = {part.name: part for part in tool.parts()}
    rig, system, others = (parts[name].command for name in ("rig", "system", "all others"))
    assert {each for each in others if each.startswith("--ignore=")} == {
        *("--ignore=tests/rig", "--ignore=tests/system", "--ignore=tests/bench", "--ignore=tests/vm")
    }
    assert [each for each in rig if each.startswith("tests/")] == ["tests/rig"]
    assert [each for each in system if each.startswith("tests/")] == ["tests/system"]
    assert not any(each.startswith("--ignore=") for each in (*rig, *system))
    assert [part.name for part in tool.parts() if part.rig] == ["rig", "system"]
