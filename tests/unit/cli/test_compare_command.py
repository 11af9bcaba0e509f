"""`palmd runs compare`: what it prints and writes, what it refuses."""

from __future__ import annotations

import json
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
