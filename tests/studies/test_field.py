"""The field's benchmark: runs that anybody can read, a scorer that finds known errors."""

import json
import math

import numpy as np
import pytest

from palmd.polygon import degrees
from palmd.record.eventlog import read_log
from tools.studies import field_runs
from tools.studies.bench_field import RUNS
from tools.studies.commands import main
from tools.studies.field_methods import METHODS
from tools.studies.field_score import FieldScore, scored, table
from tools.studies.peers.task import PeerTruth

SEED, SECONDS = 1, 2.5


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("field")
    (made / RUNS).mkdir()
    field_runs.written(made / RUNS, SEED, SECONDS)
    return made


@pytest.fixture(scope="module")
def told(folder):
    return json.loads((folder / RUNS / "0001.truth.json").read_text())


@pytest.fixture(scope="module")
def truth(told):
    return PeerTruth.from_fields(told)


def line_of(told, **changes):
    columns = {name: told[name] for name in ("t", "r1_m", "r2_m", "h_m", "rho_m", "mass_kg")}
    return {"method": "mine", "run": "0001", "cpu_s": 5.0, "h_sd_m": [1e-5] * 360} | columns | changes


def test_the_same_seed_gives_the_same_run_and_another_seed_another(folder):
    lines, told = field_runs.made(SEED, SECONDS)
    log = (folder / RUNS / "0001.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in log] == json.loads(json.dumps(lines))
    assert field_runs.made(2, SECONDS)[1]["h_m"] != told["h_m"]


def test_a_run_is_an_event_log_of_a_rig_that_is_off_and_says_by_how_much_at_most(folder, told):
    log = read_log(folder / RUNS / "0001.jsonl")
    assert log.notes == ()
    assert log.rig.pads[0].standoff_sd > 0.0
    assert all(told["rig"][name] != 0.0 for name in ("pad1_zero_m", "pad2_scale", "phi1_rad"))
    assert not any("truth" in json.loads(line) for line in (folder / RUNS / "0001.jsonl").read_text().splitlines())
    assert log.events[-1].t_sample - log.events[0].t_sample == pytest.approx(SECONDS, abs=0.1)


def test_a_plan_beyond_the_limits_is_drawn_again():
    lines, _ = field_runs.made(3, 0.5)  # its first plan opens the palms too far
    assert lines[0]["attempt"] > 0


def test_the_truth_has_no_error_and_known_errors_are_found(told, truth):
    perfect = scored(line_of(told), truth)
    assert perfect.r_rms_m == pytest.approx(0.0, abs=1e-9)
    assert perfect.e_h_m < 1e-7
    assert (perfect.known, perfect.inside, perfect.lost) == (1.0, 1.0, False)
    assert (perfect.rho, perfect.mass) == (0.0, 0.0)
    assert perfect.cpu == pytest.approx(5.0 / SECONDS, rel=0.05)
    off = scored(
        line_of(
            told,
            r1_m=[r + 3e-3 for r in told["r1_m"]],
            rho_m=1.1 * told["rho_m"],
            h_m=np.add(told["h_m"], 1e-4).tolist(),
        ),
        truth,
    )
    assert off.r_rms_m == pytest.approx(3e-3 / math.sqrt(2))
    assert off.lost
    assert off.rho == pytest.approx(0.1)
    assert 3e-5 < off.e_h_m < 1.01e-4  # a turn takes up some of it on the few normals that were touched
    assert off.inside < 0.5


def test_the_gauge_is_the_logs_beginning_and_small_turns_are_free(told, truth):
    assert told["psi_rad"][0] == 0.0
    turned = np.roll(told["h_m"], 2)
    assert scored(line_of(told, h_m=turned.tolist()), truth).e_h_m < 1e-7


def test_what_is_not_told_is_not_scored(told, truth):
    silent = scored({"method": "mine", "run": "0001"}, truth)
    assert not silent.answered
    assert math.isnan(silent.e_h_m)
    early = scored(line_of(told, t=[0.1], r1_m=[0.02], r2_m=[0.02]), truth)
    assert not early.answered
    touched = truth.touched(degrees())
    some = [h if touched[i] and i % 2 else None for i, h in enumerate(told["h_m"])]
    assert scored(line_of(told, h_m=some), truth).known == pytest.approx(0.5, abs=0.1)


def test_the_table_has_medians_of_what_was_told():
    rows = [FieldScore("a", str(i), r, 1e-5, 1.0, 0.9, 0.01, -0.02, 2.0) for i, r in enumerate((1e-4, 2e-4, 5e-3))]
    rows.append(FieldScore("a", "3"))
    (cells,) = table(rows)
    assert cells[:5] == ("a", "3 of 4", "1", "0.200", "4.040")
    assert cells[5:] == ("10", "10", "100%", "90%", "1.0", "2.0", "2.00")


def bench(folder, *arguments):
    return main(
        [
            "field",
            "--runs",
            "1",
            "--seed",
            "1",
            "--no-baselines",
            "--seconds",
            "2.5",
            "-o",
            str(folder),
            *arguments,
        ]
    )


def test_anybodys_results_are_scored_by_the_command(folder, told, tmp_path, capsys):
    mine = tmp_path / "mine.jsonl"
    mine.write_text(json.dumps(line_of(told)) + "\n")
    assert bench(folder, "--results", str(mine)) == 0
    out = capsys.readouterr().out
    assert "seeds 1 to 1" in out
    assert "mine" in out
    assert json.loads((folder / "scores.json").read_text())[0]["known"] == 1.0


def test_runs_of_another_length_are_not_taken_for_these(folder, capsys):
    assert bench(folder, "--seconds", "3") == 1
    assert "is of a run of 2.5 s, not 3 s; take another folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("{", "not JSON"),
        ('{"run": "0001"}', 'a result is an object with "method" and "run"'),
        ('{"method": "m", "run": "0815"}', "there is no run '0815'"),
        ('{"method": "m", "run": "../0001"}', "there is no run '../0001'"),
        ('{"method": "m", "run": "0001", "h_m": [0.1]}', "h_m has 1 values"),
        ('{"method": "m", "run": "0001", "t": [1], "r1_m": [], "r2_m": [1]}', "have 1, 0 and 1 values"),
        ('{"method": "m", "run": "0001", "rho_m": "big"}', "rho_m must be a number"),
    ],
)
def test_a_line_that_is_none_is_told_with_its_place(folder, tmp_path, line, said, capsys):
    mine = tmp_path / "mine.jsonl"
    mine.write_text(line + "\n")
    assert bench(folder, "--results", str(mine)) == 1
    told = capsys.readouterr().err
    assert f"{mine}:1: " in told
    assert said in told


def test_baselines_answer_in_the_form_that_is_scored(folder, truth):
    log = read_log(folder / RUNS / "0001.jsonl")
    line = {"method": "filterpy EKF", "run": "0001"} | METHODS["filterpy EKF"](log)
    score = scored(json.loads(json.dumps(line, allow_nan=False)), truth)
    assert score.known == 1.0
    assert score.r_rms_m < 5e-3
