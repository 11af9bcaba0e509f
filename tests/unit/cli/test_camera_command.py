"""`palmd report camera`: what it prints and writes, what it refuses."""

import json
import math

import filmed_run
import pytest
from filmed_run import CAMERA

from palmd.cli import main


@pytest.fixture
def folder():
    return filmed_run.made()[0]


def files(folder, *names):
    return [str(folder / name) for name in names]


def test_results_are_printed_and_written(folder, tmp_path, capsys):
    report, figure = tmp_path / "report.json", tmp_path / "camera.svg"
    result, track, log, truth = files(folder, "result.json", "track.csv", "run.jsonl", "truth.json")
    more = ["--log", log, "--outline", truth, "-o", str(report), "--figure", str(figure)]
    assert main(["report", "camera", result, track, *more]) == 0
    out = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in out] == ["clock", "frame", "orientation", "position", "outline"]
    assert "(paper: 0.27 rad, 8%)" in out[2]
    assert "(paper: 1.9 mm, 2.9 mm, 54%)" in out[4]
    line = json.loads(report.read_text())
    assert abs(line["clock"]["offset_s"] - CAMERA.offset_s) < 5e-3
    assert line["clock"]["drift_ppm"] is None
    assert line["frame"]["angle_rad"] == pytest.approx(CAMERA.angle_rad, abs=2e-3)
    assert line["frame"]["mark_x_m"] == pytest.approx(CAMERA.mark_m[0], abs=5e-4)
    assert line["psi"]["rms_rad"] == pytest.approx(CAMERA.angle_sd_rad, rel=0.3)
    assert line["mark"]["rms_m"] == pytest.approx(CAMERA.place_sd_m * math.sqrt(2), rel=0.3)
    assert line["outline"]["e_h_m"] < 1e-4
    assert line["paper"]["touched"] == 0.54
    assert figure.read_text().startswith("<?xml")
    assert figure.stat().st_size < 400_000
    first = figure.read_bytes()
    assert main(["report", "camera", result, track, *more]) == 0
    assert figure.read_bytes() == first


def test_without_a_log_only_orientation_is_compared(folder, capsys):
    assert main(["report", "camera", *files(folder, "result.json", "track.csv"), "-o", "-"]) == 0
    out, err = capsys.readouterr()
    line = json.loads(out)
    assert (line["frame"], line["mark"], line["outline"]) == (None, None, None)
    assert abs(line["clock"]["offset_s"] - CAMERA.offset_s) < 1e-2
    assert [note.split(":")[0] for note in err.splitlines()] == ["clock", "orientation"]


def test_bad_input_is_a_one_line_error_and_no_file_is_lost(folder, tmp_path, capsys):
    result, track, log = files(folder, "result.json", "track.csv", "run.jsonl")
    reconstruction = json.loads((folder / "result.json").read_text())
    bare = {"trajectory": None, "reason": "too little", "converged": False}
    made = {
        "none.json": json.dumps(reconstruction | bare),
        "list.json": "[]",
        "cut.json": '{"trajectory":',
        "ragged.json": json.dumps(reconstruction | {"h_m": reconstruction["h_m"][:-1]}),
        "null.json": json.dumps(reconstruction | {"h_m": [None, *reconstruction["h_m"][1:]]}),
        "back.json": json.dumps(
            reconstruction
            | {"trajectory": reconstruction["trajectory"] | {"t": reconstruction["trajectory"]["t"][::-1]}}
        ),
        "still.jsonl": "\n".join(
            line for line in (folder / "run.jsonl").read_text().splitlines() if "phi1" not in line
        ),
        "short.csv": "\n".join((folder / "track.csv").read_text().splitlines()[:20]),
    }
    for name, text in made.items():
        (tmp_path / name).write_text(text)
    out = tmp_path / "out.json"
    bad = {name: str(tmp_path / name) for name in made}
    before = (folder / "result.json").read_bytes()
    for arguments, what in (
        ([str(tmp_path / "no.json"), track], "No such file"),
        ([bad["none.json"], track], "has no trajectory: too little"),
        ([bad["list.json"], track], "is not a result of palmd reconstruct"),
        ([bad["cut.json"], track], "cut.json:1:15: not JSON"),
        ([bad["ragged.json"], track], "lists of equal length"),
        ([bad["null.json"], track], "h_m[0] is null, not a number"),
        ([bad["back.json"], track], "trajectory.t must increase"),
        ([result, str(tmp_path / "no.csv")], "No such file"),
        ([result, bad["short.csv"]], "short.csv: 19 rows show the object"),
        ([result, track, "--log", bad["still.jsonl"]], "has no palm angles"),
        ([result, track, "--outline", log], "a .json or a .csv file"),
        ([result, track, "--figure", str(tmp_path / "no" / "a.svg")], "cannot be written"),
        ([result, track, "-o", result], "result.json: is an input"),
        ([result, track, "--figure", track], "track.csv: is an input"),
        ([result, track, "--figure", str(tmp_path / "a.txt")], "name it .svg"),
    ):
        assert main(["report", "camera", *(["-o", str(out)] if "-o" not in arguments else []), *arguments]) == 1, what
        captured = capsys.readouterr()
        assert what in captured.err
        assert captured.err.count("\n") == 1
    assert not out.exists()
    assert (folder / "result.json").read_bytes() == before
