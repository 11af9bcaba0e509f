"""`palmd recognise`, `palmd estimate --shape`, the configuration's `observer: {shape: …}`: answers and refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest
from library import THETA, library

from palmd.cli import main
from palmd.daemon import app
from palmd.motion.check import check_files
from palmd.rig.plant import AS_ASSUMED
from palmd.rig.simulate import simulate_log
from palmd.yamlfile import ConfigError, load_config

PORTS = "pads: {palm1: {port: /dev/a}, palm2: {port: /dev/b}}\narm: {port: /dev/c}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three outlines in `library`, and the log of a run with the second."""
    folder = tmp_path_factory.mktemp("recognise")
    bodies, outlines = library("rig", 41, 3)
    (folder / "library").mkdir()
    for outline in outlines:
        written = {"name": outline.name, "theta_rad": THETA.tolist(), "h_m": outline.h.tolist(), "rho_m": outline.rho}
        (folder / "library" / f"{outline.name[-1]}.json").write_text(json.dumps(written | {"h_sd_m": [2e-5] * 360}))
    lines, _ = simulate_log("rig", 41, 2.5, AS_ASSUMED, bodies[1])
    (folder / "run.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return folder


def test_recognise_prints_and_writes_the_probabilities(folder, tmp_path, capsys):
    out = tmp_path / "out.json"
    assert main(["recognise", str(folder / "run.jsonl"), str(folder / "library"), "-o", str(out)]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("body 1")
    assert "body 1, since" in printed[-1]
    answer = json.loads(out.read_text())
    assert answer["names"] == ["body 0", "body 1", "body 2"]
    assert answer["best"] == "body 1"
    assert sum(answer["probability"]) + answer["none"] == pytest.approx(1.0)
    assert 0.0 < answer["decided_s"] < 2.5
    assert main(["recognise", str(folder / "run.jsonl"), str(folder / "library"), "-o", "-"]) == 0
    assert json.loads(capsys.readouterr().out) == answer


def test_estimate_with_a_stored_outline(folder, tmp_path):
    out = tmp_path / "out.jsonl"
    shape = str(folder / "library" / "1.json")
    assert main(["estimate", str(folder / "run.jsonl"), "-o", str(out), "--shape", shape]) == 0
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    objects = [line["object"] for line in lines if isinstance(line.get("object"), dict)]
    assert [each["best"] for each in objects] == ["body 1", "body 1"]
    estimates = [line for line in lines if "nis" in line]
    assert estimates[-1]["valid"]
    assert estimates[-1]["sd"]["psi_rad"] < 0.1


def test_bad_input_is_a_one_line_error(folder, tmp_path, capsys):
    log, library_ = str(folder / "run.jsonl"), str(folder / "library")
    empty, bad, silent = tmp_path / "empty", tmp_path / "bad.json", tmp_path / "silent.jsonl"
    empty.mkdir()
    bad.write_text(json.dumps({"theta_rad": THETA.tolist(), "h_m": np.full(360, 20.0).tolist()}))
    header, *events = (folder / "run.jsonl").read_text().splitlines()
    silent.write_text("\n".join([header, *(line for line in events if "palms" in line)]) + "\n")
    out = tmp_path / "out.json"
    for arguments, error in (
        (["recognise", log, str(empty)], "holds no outline"),
        (["recognise", log, str(tmp_path / "none")], "No such file"),
        (["recognise", log, str(bad)], "is h_m in mm?"),
        (["recognise", str(tmp_path / "none.jsonl"), library_], "No such file"),
        (["recognise", str(silent), library_, "-o", str(out)], "never touched both palms"),
        (["estimate", log, "-o", str(out), "--shape", str(bad)], "is h_m in mm?"),
        (["estimate", log, "-o", str(out), "--shape", library_, "--observer", "extended"], "needs --observer shape"),
    ):
        assert main(arguments) == 1
        captured = capsys.readouterr()
        assert error in captured.err
        assert captured.err.count("\n") == 1
        assert not captured.out
    assert not out.exists()


# ---- the configuration


def configured(folder, observer):
    path = folder / "palmd.yaml"
    path.write_text(f"{PORTS}observer: {observer}\n")
    return path


def test_the_configuration_names_an_outline_or_a_folder(folder):
    config = load_config(configured(folder, "{shape: library}"))
    assert config.observer.shape == folder / "library"
    assert check_files([configured(folder, "{shape: library/1.json}")]) == []


@pytest.mark.parametrize(
    ("observer", "problem"),
    [("{shape: nowhere.json}", "does not exist"), ("{primary: extended, shape: library}", "needs primary: shape")],
)
def test_an_impossible_shape_is_reported_with_its_place_when_the_configuration_is_loaded(folder, observer, problem):
    path = configured(folder, observer)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    (line,) = caught.value.errors
    assert line.startswith(f"{path}:3:{path.read_text().splitlines()[2].index('shape: ') + 8}: observer.shape: ")
    assert problem in line
    assert check_files([path]) == caught.value.errors


def test_a_rejected_outline_is_reported_by_check_and_by_the_daemon(folder, capsys):
    (folder / "bad.json").write_text(json.dumps({"theta_rad": THETA.tolist(), "h_m": [20.0] * 360}))
    path = configured(folder, "{shape: bad.json}")
    (line,) = check_files([path])
    assert line.startswith(f"{path}:3:19: observer.shape: {folder / 'bad.json'}")
    assert app.run(path) == 1
    assert "is h_m in mm?" in capsys.readouterr().err
