"""Logs of three palms in space: reading, errors, and the files written of a body."""

import json
import math

import numpy as np
import pytest

import palmd
from palmd.cli import main
from palmd.model.icosphere import icosphere
from palmd.observer.three_palms.path import joint_path
from palmd.observer.three_palms.reconstruct import longest_stretch
from palmd.observer.three_palms.record import PadReadings
from palmd.record.logreader import LogError
from palmd.record.surface import MESHES, Mesh, sd_colours
from palmd.record.systems import read_log_of_any
from palmd.record.systems.three_palms import path_and_readings
from palmd.system.three_palms import ThreePalmsRig
from tools.studies.space_logs import header


def joints(t, angle=(0.9, 0.8, 0.8)):
    return {"t": t, "joints": {"angle_rad": list(angle), "rate_rad_s": [0.0] * 3, "acc_rad_s2": [0.0] * 3}}


@pytest.fixture
def log(tmp_path):
    """Writes a log with these lines after its header, which is changed by `rig`."""

    def write(*lines, **rig):
        head = header(ThreePalmsRig())
        head["rig"] |= rig
        path = tmp_path / "run.jsonl"
        path.write_text("".join(json.dumps(line) + "\n" for line in [head, *lines]))
        return path

    return write


def test_both_coordinates_and_the_joints_are_read(log):
    path = log(
        *(joints(0.016 * k) for k in range(10)),
        {"t": 0.15, "pad": 3, "a_m": 0.01, "b_m": -0.02},
        {"t": 0.151, "pad": 1, "a_m": 0.2, "b_m": 0.0},
    )
    system, run = read_log_of_any(path)
    assert system.name == "three_palms"
    assert [note.split(": ")[1] for note in run.notes] == ["1 readings off the pad ignored"]
    moved, readings = path_and_readings(run)
    assert readings.pad.tolist() == [2]
    assert readings.value.tolist() == [[0.01, -0.02]]
    assert math.isnan(readings.force[0])
    np.testing.assert_allclose(moved.angle(np.array([0.05])), [[0.9, 0.8, 0.8]], atol=1e-9)


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ({"t": 0.0, "pad": 4, "a_m": 0.0, "b_m": 0.0}, "pad must be 1, 2 or 3, got 4"),
        ({"t": 0.0, "pad": 1, "a_m": 0.0}, "b_m is missing"),
        ({"t": 0.0, "joints": {"angle_rad": [0.1, 0.2]}}, "angle_rad must be a list of 3 numbers"),
        ({"t": 0.0, "joints": {}}, "angle_rad is missing"),
    ],
)
def test_a_bad_line_is_reported_with_its_number(log, line, what):
    with pytest.raises(LogError, match=f":2: {what}"):
        read_log_of_any(log(line))


def test_another_mechanism_is_refused(log):
    with pytest.raises(LogError, match=r":1: rig\.mechanism must be edge-axis"):
        read_log_of_any(log(joints(0.0), mechanism="spider"))


def test_too_few_readings_do_not_converge(log, tmp_path, capsys):
    path, out = log(*(joints(0.016 * k) for k in range(200))), tmp_path / "out.json"
    assert main(["reconstruct", str(path), "-o", str(out)]) == 0
    result = json.loads(out.read_text())
    assert result["converged"] is False
    assert (result["reason_code"], "a gap in the reports" in result["reason"]) == ("too-short", True)
    assert main(["reconstruct", str(path), "-o", str(tmp_path / "out.stl")]) == 1
    assert "there is no surface to write" in capsys.readouterr().err


def test_without_joints_the_library_gives_the_reason(log):
    answer = palmd.reconstruct(log({"t": 0.0, "pad": 1, "a_m": 0.01, "b_m": 0.01}))
    assert (answer.verdict, answer.coverage, len(answer.trajectory["t_s"])) == ("rejected", 0.0, 0)
    assert "joints" in answer.reason
    assert answer.results["reason_code"] == "no-arm-reports"


def test_unsupported_options_are_refused_in_one_sentence(log, tmp_path, capsys):
    path, out = log(joints(0.0)), str(tmp_path / "out")
    assert main(["reconstruct", str(path), "-o", out, "--calibration-sd", "zero_m=0.001"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_a_log_is_estimated_tick_by_tick_with_the_fields_of_its_topic(log, tmp_path):
    reports = [joints(0.016 * k) for k in range(30)]
    readings = [{"t": 0.01 * k + 0.002, "pad": 1 + k % 3, "a_m": 0.0, "b_m": 0.02, "force_n": 0.2} for k in range(45)]
    path, out = log(*sorted([*reports, *readings], key=lambda line: line["t"])), tmp_path / "out.jsonl"
    assert main(["estimate", str(path), "-o", str(out)]) == 0
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    assert len(lines) == 47
    assert lines[-1]["beta_rad"] == pytest.approx(0.9)
    assert lines[-1]["valid"] is False
    assert lines[-1]["reason"]
    assert lines[-1]["invalid_reasons"] == ["no-object"]
    assert {"quat_xyzw", "omega_x_rad_s", "com_z_m", "a3_m", "h2_m", "f1_n", "inertia_xx_m2"} <= set(lines[-1])


def test_the_longest_stretch_has_no_silent_pad():
    t = 0.01 * np.arange(1, 500)
    path = joint_path(0.016 * np.arange(320), np.zeros((320, 3)), np.zeros((320, 2, 3)), 1e-4)
    whole = [(at, pad) for at in t for pad in range(3) if not (pad == 1 and 1.0 < at < 1.5)]
    readings = PadReadings(
        np.array([at for at, _ in whole]), np.array([pad for _, pad in whole]),
        np.zeros((len(whole), 2)), np.zeros(len(whole)),
    )  # fmt: skip
    start, end = longest_stretch(path, readings)
    assert start == pytest.approx(1.5, abs=0.02)
    assert end == pytest.approx(4.99, abs=0.02)


def test_a_mesh_is_closed_and_faces_outwards():
    points, triangles = icosphere(2)
    edges = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    assert {tuple(edge) for edge in edges.tolist()} == {(b, a) for a, b in edges.tolist()}
    corners = points[triangles]
    volume = np.linalg.det(corners).sum() / 6
    assert 0.9 * 4 * np.pi / 3 < volume < 4 * np.pi / 3
    sizes = {suffix: len(made(Mesh(points, triangles))) for suffix, made in MESHES.items()}
    assert sizes[".stl"] == 84 + 50 * len(triangles)
    assert MESHES[".obj"](Mesh(points, triangles)).decode().count("\nf ") == len(triangles)


def test_a_ply_is_coloured_by_the_sd_where_it_was_touched():
    points, triangles = icosphere(0)
    sd, touched = np.full(len(points), 3e-6), np.arange(len(points)) % 2 == 0
    sd[2] = 3e-4
    lines = MESHES[".ply"](Mesh(0.02 * points, triangles, sd, touched)).decode().splitlines()
    first = lines.index("end_header") + 1
    vertices = [line.split() for line in lines[first : first + len(points)]]
    assert [int(each) for each in vertices[0][3:6]] == sd_colours(sd, touched)[0].tolist() == [68, 1, 84]
    assert vertices[2][3:6] == ["253", "231", "37"]
    assert vertices[1][3:6] == ["176"] * 3
    assert [float(row[6]) for row in vertices[:3]] == [0.003, 0.003, 0.3]
    np.testing.assert_allclose([[float(each) for each in row[:3]] for row in vertices], 20 * points, atol=1e-6)
