"""`palmd reconstruct`: its JSON, its summary, its output files, what it refuses."""

import json
import math

import numpy as np
import pytest

from palmd.cli import main
from palmd.observer.mass import MassEstimator
from palmd.observer.outline import directions
from palmd.observer.reconstruction import Reconstruction
from palmd.record.result import as_line
from palmd.record.systems import two_palms
from palmd.rig.simulate import simulate_log
from palmd.system.description import PadSensor
from palmd.system.reasons import Code, Reason
from palmd.system.rig_constants import RIG_NAMES

SECONDS = 2.5
FIELDS = {
    "verdict", "converged", "coverage", "reason", "reason_code", "chi2", "theta_rad", "h_m", "h_sd_m", "touched",
    "rho_m", "rho_sd_m", "mu", "mu_sd", "visits", "kept_paper", "kept_band", "mass_rest_kg", "mass_rest_sd_kg",
    "mass_kg", "mass_sd_kg", "trajectory", "seconds", "rig", "contradicted", "sides", "chords", "shape_class",
    "looks_like",
}  # fmt: skip


def answer(**changes):
    theta, t, rig = directions(), np.array([0.1, 0.2]), np.arange(float(len(RIG_NAMES)))
    values = {
        "converged": True, "chi2": 1.0, "seconds": 1.5,
        "theta": theta, "h": 0.02 + 0 * theta, "h_sd": 1e-5 + 0 * theta,
        "visits": 2 * (theta < 0.5) + (theta < 1.0), "touched": theta < 1.0,
        "rho": 0.014, "rho_sd": 1e-3, "mu": 0.1, "mu_sd": 0.01, "mass": math.nan, "mass_sd": math.nan,
        "t": t, "psi": t, "omega0": 2 * t, "radii": np.stack([t, t]),
        "rig": rig, "rig_covariance": np.eye(len(rig)) / 4, "rig_prior_sd": np.ones(len(rig)),
        "contradicted": 6.0 * (rig == 1),
    }  # fmt: skip
    return Reconstruction(**values | changes)


def unweighed():
    return MassEstimator((PadSensor(), PadSensor()))


def nothing():
    none = np.zeros(0)
    absent = dict.fromkeys(("chi2", "rho", "rho_sd", "mu", "mu_sd"), math.nan)
    columns = dict.fromkeys(("t", "psi", "omega0", "rig"), none)
    columns |= {"radii": np.zeros((2, 0)), "rig_covariance": np.zeros((0, 0))}
    return answer(
        converged=False,
        h=None,
        h_sd=None,
        touched=None,
        visits=None,
        reason=Reason(Code.UNDETERMINED, "too little"),
        **absent,
        **columns,
    )


def test_the_result_has_the_fields_of_the_contract():
    line = as_line(answer(), unweighed())
    assert set(line) == FIELDS
    assert line["reason"] is None
    assert [len(line[name]) for name in ("theta_rad", "h_m", "h_sd_m", "touched")] == [360] * 4
    assert set(line["touched"]) == {0, 1}
    assert sum(line["touched"]) == 58
    assert [sum(line[name]) for name in ("visits", "kept_paper", "kept_band")] == [58 + 2 * 29, 29, 58]
    doubtful = as_line(answer(h_sd=np.where(directions() < 0.25, 1e-5, 1e-4)), unweighed())
    assert (sum(doubtful["kept_paper"]), sum(doubtful["kept_band"])) == (29, 15)
    assert set(line["kept_paper"]) == set(line["kept_band"]) == {0, 1}
    assert line["mass_kg"] is line["mass_sd_kg"] is None
    assert (line["rho_m"], line["mu_sd"], line["seconds"]) == (0.014, 0.01, 1.5)
    assert line["rig"]["pad2_zero_m"] == {"value": 1.0, "sd": 0.5}
    assert len(line["rig"]) == len(RIG_NAMES)
    assert line["sides"] == []
    fields = as_line(answer(sides=np.array([[0.5, 0.012, 0.002]])), unweighed())
    assert fields["sides"] == [{"normal_rad": 0.5, "length_m": 0.012, "length_sd_m": 0.002}]
    assert line["shape_class"]["name"] is None
    assert line["looks_like"] == line["shape_class"]
    assert "flat side or bridged dent of 12.0 ± 2.0 mm, explains 0.0 s between 0.1 and 0.2 s" in two_palms.summary(
        answer(sides=np.array([[0.5, 0.012, 0.002]]))
    )
    assert as_line(nothing(), unweighed())["shape_class"] is None
    assert line["contradicted"] == {"pad2_zero_m": 6.0}
    assert line["trajectory"] == {
        "t": [0.1, 0.2], "psi_rad": [0.1, 0.2], "omega0_rad_s": [0.2, 0.4], "r1_m": [0.1, 0.2], "r2_m": [0.1, 0.2]
    }  # fmt: skip


def test_missing_values_are_null():
    line = as_line(nothing(), unweighed())
    assert set(line) == FIELDS
    assert (line["converged"], line["reason"], line["reason_code"]) == (False, "too little", "undetermined")
    assert len(line["theta_rad"]) == 360
    absent = FIELDS - {"verdict", "coverage", "converged", "reason", "reason_code", "theta_rad", "seconds"}
    assert [line[name] for name in absent] == [None] * len(absent)
    json.dumps(line, allow_nan=False)
    spoilt = as_line(answer(h=np.full(360, math.nan), chi2=math.inf), unweighed())
    assert (spoilt["h_m"], spoilt["chi2"]) == ([None] * 360, None)


# ---------------------------------------------------------------------------------------------- the command


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "run.jsonl"
    lines, _ = simulate_log("nominal", 1, SECONDS)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


@pytest.fixture(scope="module")
def result(log):
    out = log.with_name("result.json")
    assert main(["reconstruct", str(log), "-o", str(out)]) == 0
    return json.loads(out.read_text())


def without_seconds(line):
    return {name: value for name, value in line.items() if name != "seconds"}


def test_the_command_writes_one_result(log, result):
    assert set(result) == FIELDS
    assert result["converged"] is True
    assert result["reason"] is None
    assert 0.1 < sum(result["touched"]) / 360 < 0.5
    trajectory = result["trajectory"]
    assert len({len(column) for column in trajectory.values()}) == 1
    assert trajectory["psi_rad"][0] == pytest.approx(0.0, abs=1e-5)
    assert 0.0 <= trajectory["t"][0] < 0.03
    assert trajectory["t"][-1] == pytest.approx(SECONDS, abs=0.06)


@pytest.mark.usefixtures("result")
def test_an_outline_for_cad_is_that_of_the_result(log, tmp_path, capsys):
    direct, converted = tmp_path / "direct.csv", tmp_path / "converted.csv"
    assert main(["reconstruct", str(log), "-o", str(direct)]) == 0
    assert "outline ±" in capsys.readouterr().err
    assert main(["export", str(log.with_name("result.json")), "-o", str(converted)]) == 0
    assert direct.read_text().splitlines()[1:] == converted.read_text().splitlines()[1:]
    copy = tmp_path / "log.csv"
    copy.write_bytes(log.read_bytes())
    assert main(["reconstruct", str(copy), "-o", str(copy)]) == 1
    assert "is the input" in capsys.readouterr().err


def test_a_reconstruction_without_an_outline_draws_none(log, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("palmd.observer.reconstruct.reconstruct", lambda *_, **__: nothing())
    assert main(["reconstruct", str(log), "-o", str(tmp_path / "o.svg")]) == 1
    assert "not converged: too little: there is no outline to draw" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_standard_output_summary_and_notes(log, result, tmp_path, capsys):
    cut = tmp_path / "cut.jsonl"
    cut.write_bytes(log.read_bytes() + b'{"t":2.4,"pad":1,"s')
    assert main(["reconstruct", str(cut), "-o", "-", "--seed", "0"]) == 0
    out, err = capsys.readouterr()
    assert without_seconds(json.loads(out)) == without_seconds(result)
    note, summary = err.splitlines()
    assert "is truncated" in note
    assert summary.startswith(f"{cut}: outline ± ")
    for part in (" µm on ", "% of the normals", ", rho ", " mm, mu ", ", mass ", " g, "):
        assert part in summary


@pytest.mark.parametrize("given", ["map_length_m=0", "map_length_m=-1", "map_m=nan", "map_mm=0.07"])
def test_an_impossible_placement_error_is_refused(log, tmp_path, given, capsys):
    out = tmp_path / "out.json"
    with pytest.raises(SystemExit) as stopped:
        main(["reconstruct", str(log), "-o", str(out), "--calibration-sd", given])
    assert stopped.value.code == 2
    assert given.partition("=")[0] in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("source", ["pad", "palms"])
def test_a_log_with_too_few_readings_is_no_fault(log, source, tmp_path, capsys):
    header, *events = log.read_text().splitlines()
    poor, out = tmp_path / "poor.jsonl", tmp_path / "out.json"
    poor.write_text("\n".join([header, *(line for line in events if source in json.loads(line))]) + "\n")
    assert main(["reconstruct", str(poor), "-o", str(out)]) == 0
    line = json.loads(out.read_text())
    assert line["converged"] is False
    assert capsys.readouterr().err == f"{poor}: not converged: {line['reason']}\n"


def test_bad_input_is_a_one_line_error(log, tmp_path, capsys):
    short = tmp_path / "short.jsonl"
    short.write_text("\n".join(log.read_text().splitlines()[:3]) + "\n")
    before, out = short.read_bytes(), tmp_path / "out.json"
    for arguments, problem in (
        ([str(tmp_path / "none.jsonl"), "-o", str(out)], "No such file"),
        ([str(short), "-o", str(tmp_path / "no" / "out.json")], "cannot be written: No such file"),
        ([str(short), "-o", str(short)], "is the log itself"),
        ([str(short), "-o", str(tmp_path)], "cannot be written: Is a directory"),
    ):
        assert main(["reconstruct", *arguments]) == 1
        err = capsys.readouterr().err
        assert problem in err
        assert err.count("\n") == 1
    assert not out.exists()
    assert short.read_bytes() == before


@pytest.mark.parametrize("option", ["-o", "--mesh"])
def test_nothing_is_computed_if_the_output_cannot_be_written(log, tmp_path, monkeypatch, capsys, option):
    monkeypatch.setattr("palmd.observer.reconstruct.reconstruct", lambda *_, **__: pytest.fail("it was computed"))
    (tmp_path / "folder.ply").mkdir()
    for target, why in ((tmp_path / "nowhere" / "x.ply", "No such file"), (tmp_path / "folder.ply", "Is a directory")):
        first = [] if option == "-o" else ["-o", str(tmp_path / "x.json")]
        assert main(["reconstruct", str(log), *first, option, str(target)]) == 1
        assert why in capsys.readouterr().err


def test_an_object_at_rest_gets_a_mass_but_no_outline(tmp_path, capsys):
    """Section 4.1: mass without motion."""
    log, out = tmp_path / "still.jsonl", tmp_path / "out.json"
    lines, truth = simulate_log("friction", 405, 0.4)
    palms = next(line["palms"] for line in lines if "palms" in line)
    phi1, phi2 = palms["phi1_rad"], palms["phi2_rad"]
    forces = [truth["mass_kg"] * 9.81 * math.sin(angle) / math.sin(phi2) for angle in (phi1 + phi2, phi1)]
    events = []
    for k in range(100):
        t = k * 0.01
        events.append({"t": t, "palms": {"phi1_rad": phi1, "phi2_rad": phi2}})
        events += [{"t": t, "pad": pad, "s_m": 0.02, "force_n": forces[pad - 1]} for pad in (1, 2)]
    log.write_text("".join(json.dumps(line) + "\n" for line in [lines[0], *events]))
    assert main(["reconstruct", str(log), "-o", str(out)]) == 0
    line = json.loads(out.read_text())
    assert not line["converged"]
    assert line["mass_rest_kg"] == pytest.approx(truth["mass_kg"], rel=1e-3)
    assert 0 < line["mass_rest_sd_kg"] < 0.01 * truth["mass_kg"]
    assert "at rest" in capsys.readouterr().err
