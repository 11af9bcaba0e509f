"""`palmd runs compare`: what it prints and writes, what it refuses."""

from __future__ import annotations

import json
import math
from pathlib import Path

import filmed_run
import numpy as np
import pytest
from filmed_run import CAMERA

from palmd.cli import main


@pytest.fixture(scope="module")
def folder() -> Path:
    """A reconstruction, a camera's track of the run as CSV and, of another camera, in the TUM format."""
    path, table = filmed_run.made()
    half = np.radians(table["object_angle_deg"]) / 2
    columns = [table["t_s"] + 5.0, table["object_x_mm"] / 1e3, table["object_y_mm"] / 1e3, 0 * half, 0 * half,
               0 * half, np.sin(half), np.cos(half)]  # fmt: skip
    rows = "\n".join(" ".join(f"{value:.9f}" for value in row) for row in np.stack(columns, axis=1))
    (path / "track.tum").write_text(f"# time x y z qx qy qz qw\n{rows}\n")
    return path


def test_a_result_is_compared_with_tracks_in_two_formats(folder, tmp_path, capsys) -> None:
    figure, output = tmp_path / "errors.svg", tmp_path / "errors.json"
    result, csv, tum = (str(folder / name) for name in ("result.json", "track.csv", "track.tum"))
    assert main(["compare", csv, tum, "--reference", result, "-o", str(output), "--figure", str(figure)]) == 0
    rows = json.loads(output.read_text())
    assert [row["file"] for row in rows] == ["track.csv", "track.tum"]
    for row, offset_s in zip(rows, (CAMERA.offset_s, CAMERA.offset_s - 5.0), strict=True):
        assert abs(row["clock_offset_s"] - offset_s) < 5e-3
        assert row["rotation_rms_rad"] == pytest.approx(CAMERA.angle_sd_rad, rel=0.3)
        assert row["position_rms_m"] is None  # a result has no position
    assert "track.tum" in capsys.readouterr().out
    assert figure.read_text().startswith("<?xml")


def test_a_result_is_compared_with_a_track_by_position_and_outline_too(folder, tmp_path, capsys) -> None:
    result, track, log, truth = (str(folder / name) for name in ("result.json", "track.csv", "run.jsonl", "truth.json"))
    output, figure = tmp_path / "errors.json", tmp_path / "errors.svg"
    arguments = [result, track, "--log", log, "--outline", truth, "-o", str(output), "--figure", str(figure)]
    assert main(["runs", "compare", *arguments]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[-1].startswith("result.json in track.csv: clock +37.2")
    (row,) = json.loads(output.read_text())
    assert (row["file"], row["reference"]) == ("result.json", "track.csv")
    assert abs(row["clock_offset_s"] + CAMERA.offset_s) < 5e-3
    assert row["clock_offset_sd_s"] < 2e-3
    assert row["clock_drift"] is None
    assert row["frame_rad"][2] == pytest.approx(CAMERA.angle_rad, abs=4.0 * row["frame_sd_rad"][2])
    assert row["frame_sd_rad"][2] < 0.02
    assert row["point_m"][:2] == pytest.approx(CAMERA.mark_m, abs=5e-4)
    assert row["point_sd_m"][2] is None
    assert row["rotation_rms_rad"] == pytest.approx(CAMERA.angle_sd_rad, rel=0.3)
    assert row["position_rms_m"] == pytest.approx(CAMERA.place_sd_m * math.sqrt(2), rel=0.3)
    assert row["outline_rms_m"] < 1e-4
    first = figure.read_bytes()
    assert len(first) < 400_000
    assert main(["report", "camera", *arguments]) == 0
    assert figure.read_bytes() == first
    assert "palmd report camera is now: palmd runs compare" in capsys.readouterr().err


def test_bad_input_is_a_one_line_error_and_no_file_is_lost(folder, tmp_path, capsys) -> None:
    result, track, log = (str(folder / name) for name in ("result.json", "track.csv", "run.jsonl"))
    reconstruction = json.loads((folder / "result.json").read_text())
    made = {
        "none.json": json.dumps(reconstruction | {"trajectory": None, "reason": "too little", "converged": False}),
        "list.json": "[]",
        "ragged.json": json.dumps(reconstruction | {"h_m": reconstruction["h_m"][:-1]}),
        "null.json": json.dumps(reconstruction | {"h_m": [None, *reconstruction["h_m"][1:]]}),
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
        ([str(tmp_path / "no.json"), track], "no such file"),
        ([bad["none.json"], track], "has no trajectory: too little"),
        ([bad["list.json"], track], "is not a result of palmd reconstruct"),
        ([bad["ragged.json"], track], "lists of equal length"),
        ([bad["null.json"], track], "h_m[0] is null, not a number"),
        ([result, bad["short.csv"]], "short.csv: 19 rows show the object"),
        ([result, track, "--log", bad["still.jsonl"]], "has no palm angles"),
        ([result, track, "--outline", log], "a .json or a .csv file"),
        ([result, track, "--figure", str(tmp_path / "no" / "a.svg")], "cannot be written"),
        ([result, track, "-o", result], "result.json: is an input"),
        ([result, track, "--figure", str(tmp_path / "a.txt")], "use the suffix .svg"),
    ):
        assert main(["runs", "compare", *(["-o", str(out)] if "-o" not in arguments else []), *arguments]) == 1, what
        captured = capsys.readouterr()
        assert what in captured.err
        assert captured.err.count("\n") == 1
    assert not out.exists()
    assert (folder / "result.json").read_bytes() == before


def test_two_tracks_are_also_compared_by_position(folder, capsys) -> None:
    csv, tum = (str(folder / name) for name in ("track.csv", "track.tum"))
    assert main(["compare", csv, tum, "-o", "-"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["position_rms_m"] < 1e-6


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("a.tum", "0 0 0 0 0 0 0 one\n", "a.tum:1: a column is not a number"),
        ("a.tum", "0 0 0 0 0 0 0 0\n", "a.tum:1: a column is not finite, or the quaternion is zero"),
        ("a.tum", "1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", "a.tum:2: time is 0 after 1: it must increase"),
        ("a.xyz", "1\n", "a.xyz: is not a recording; tracks have the suffix .csv or .tum, results .json"),
        ("a.json", "{", "a.json:1:2: not JSON: Expecting property name enclosed in double quotes"),
    ],
)
def test_input_that_cannot_be_compared_is_a_one_line_error(name, text, error, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(text)
    assert main(["compare", name, name]) == 1
    assert capsys.readouterr().err == f"{error}\n"


def test_a_single_file_without_truth_is_an_error(folder, monkeypatch, capsys) -> None:
    monkeypatch.chdir(folder)
    assert main(["compare", "track.tum"]) == 1
    assert "name a second run or --reference" in capsys.readouterr().err
