"""The study of live explorations of a pivoting grasp: rows kept in a file, what is right and what is wrong."""

import json
import math
from dataclasses import replace

import pytest

from palmd.console.errors import BAD_INPUT
from tools.studies import pivot_live
from tools.studies.commands import main
from tools.studies.pivot_live import LiveRow, LiveTask
from tools.studies.scoring import as_line

TASK = LiveTask(7, "calibrated", 5.0)
GOOD = LiveRow(
    TASK, claimed=True, ended="done", t_end=90.0, t_claim=50.0, e=2e-5, most=4e-5, sd=3e-5, touched=0.7, worst_e=5e-5,
    worst_z=1.2, claims=4, mu_error=0.002, mu_z=0.5, ticks=9000, valid=4000, most_force=1.2, force_limit=2.0,
)  # fmt: skip


@pytest.mark.parametrize("row", [GOOD, LiveRow(TASK, error="ValueError: no")])
def test_a_row_comes_back_from_its_file(row):
    again = pivot_live.row_from(json.loads(json.dumps(as_line(row), allow_nan=False)))
    assert repr(again) == repr(row)


def test_what_is_right_and_what_is_wrong():
    assert GOOD.right
    assert not GOOD.wrong_claim
    assert replace(GOOD, worst_z=3.5).wrong_claim
    assert replace(GOOD, worst_e=4e-4).wrong_claim
    assert not replace(GOOD, claimed=False).right
    assert not LiveRow(TASK, error="no").wrong_claim


def test_the_table_counts_them():
    wrong = replace(GOOD, task=LiveTask(8, "calibrated", 5.0), e=4e-4, worst_e=4e-4)
    slide = replace(GOOD, task=LiveTask(7, "calibrated", 5.0, "float"), left=3, jams=2, most_force=2.3)
    table = pivot_live.report([GOOD, wrong, slide, LiveRow(LiveTask(9, "none", 5.0), error="no")])
    titles, calibrated, sliding, perfect = (line.split() for line in table.splitlines()[:4])
    assert sliding[:5] == ["calibrated,", "slide", "1", "1", "0"]
    assert "right" in titles
    assert calibrated[:5] == ["calibrated", "2", "1", "0", "1"]
    assert perfect[:5] == ["none", "1", "0", "1", "0"]
    assert sliding[-6:-2] == ["1", "1", "1", "2.30"], "one left the pad, one jammed, one over its limit"
    assert calibrated[-6:-2] == ["0", "0", "0", "1.20"]
    assert "400 µm off" in pivot_live.remark(wrong)


def test_another_line_is_no_row():
    with pytest.raises(KeyError):
        pivot_live.row_from({"seed": 1})


def test_what_is_done_is_not_done_again():
    tasks = pivot_live.tasks_of("calibrated", 5.0, "rigid", range(6, 9), {TASK: GOOD})
    assert [task.seed for task in tasks] == [6, 8]
    assert len(pivot_live.tasks_of("calibrated", 5.0, "float", range(6, 9), {TASK: GOOD})) == 3
    assert math.isnan(LiveRow(TASK).e)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda path: path.mkdir(), "cannot be read: Is a directory"),
        (lambda path: path.write_text('{"seed": 3}\n'), "is no file of this study: line 1 is no run"),
        (lambda path: path.write_bytes(b"\xff\xfe\x00"), "is no file of this study: line 1 is no run"),
    ],
)
def test_what_cannot_be_gone_on_with_is_refused_and_left_alone(tmp_path, capsys, made, said):
    path = tmp_path / "runs.jsonl"
    made(path)
    before = path.is_dir() or path.read_bytes()
    assert main(["pivot", "--live", "--runs", "1", "-o", str(path)]) == BAD_INPUT
    assert said in capsys.readouterr().err
    assert (path.is_dir() or path.read_bytes()) == before
