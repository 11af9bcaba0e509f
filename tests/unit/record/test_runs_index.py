"""Recordings as a collection: the summary of each, the index that is always rebuilt, and `palmd runs`."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from recorded import BEGIN, begun, config, message

from palmd.cli import main
from palmd.cli.runs import matches
from palmd.quantities import ESTIMATE, MOTION, OBJECT, SHAPE, STATE
from palmd.record import index
from palmd.record.index import NAME, IndexedRun, RunSummary, annotate, indexed
from palmd.record.metadata import preface
from palmd.record.runfile import RunFile
from palmd.record.summary import summary_of

HELD = {"faults": ["pad1-silent", "no-realtime"], "severities": ["hold", "note"], "state": "hold", "hints": ["", ""]}
SHAPED = {"theta_rad": [0.0, 1.0, 2.0], "h_m": [0.02] * 3, "h_sd_m": [1e-5, 2e-5, 9e-5], "touched": [1, 1, 0]}


def recording(folder: Path, *extra: tuple[str, dict], old: bool = True) -> Path:
    """A finished recording with these messages."""
    file = RunFile(folder, preface(config(folder), BEGIN.isoformat()), BEGIN)
    for number, (topic, fields) in enumerate(extra):
        file.write(message(topic, fields, 10 * number, 0.5 * number))
    file.finish()
    if old:
        os.utime(file.path, (1e9, 1e9))
    return file.path


def messages_of(best: str = "", mass_kg: float = 0.2) -> list[tuple[str, dict]]:
    """The daemon's messages in a run with one hold."""
    return [
        (MOTION.name, {"plan": "rock"}),
        (STATE.name, HELD),
        (ESTIMATE.name, {"valid": True, "object": 2, "mass_kg": mass_kg}),
        (SHAPE.name, SHAPED),
        (OBJECT.name, {"names": ["cup"], "probability": [0.9], "none": 0.0, "best": best}),
        (STATE.name, {"faults": [], "severities": [], "state": "ready", "hints": []}),
    ]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three recordings: two of a cup, and a file that is no recording."""
    for number, best in enumerate(("cup", "cup")):
        recording(tmp_path / "x", *messages_of(best)).rename(tmp_path / f"2026-11-2{number}T10-00-00Z.mcap")
        (tmp_path / "x").rmdir()
    (tmp_path / "2026-11-22T10-00-00Z.mcap").write_text("hello")
    os.utime(tmp_path / "2026-11-22T10-00-00Z.mcap", (1e9, 1e9))
    return tmp_path


def test_a_run_has_a_short_summary(tmp_path: Path) -> None:
    found = summary_of(recording(tmp_path, *messages_of("cup")))
    assert found == RunSummary(
        started=BEGIN.isoformat(),
        seconds=pytest.approx(2.5),
        complete=True,
        plans=("rock",),
        object="cup",
        objects=2,
        touched=pytest.approx(2 / 3),
        sd_m=2e-5,
        worst_sd_m=9e-5,
        mass_kg=0.2,
        state="ready",
        valid=True,
        faults=("pad1-silent",),
    )


def test_losses_are_counted_once_and_the_last_valid_outline_counts(tmp_path: Path) -> None:
    lost = {
        "number": [3, 4],
        "kind": ["object"] * 2,
        "name": ["lost", "begun"],
        "text": ["object 1 is lost", "object 2"],
    }
    reset_shape = SHAPED | {"touched": [0] * len(SHAPED["touched"])}
    after = [(ESTIMATE.name, {"valid": False, "object": 3}), (SHAPE.name, reset_shape), *[("palm/log", lost)] * 2]
    found = summary_of(recording(tmp_path, *messages_of("cup"), *after))
    assert (found.lost, found.valid, found.touched) == (1, False, pytest.approx(2 / 3))


def test_a_note_in_the_log_is_in_the_summary(tmp_path: Path) -> None:
    log = {"kind": ["note", "fault", "command"], "name": ["", "x", "note"], "text": ["cup moved", "no", "again"]}
    assert summary_of(recording(tmp_path, ("palm/log", log), ("palm/log", log))).notes == ("cup moved", "again")


def test_unfinished_and_invalid_recordings_are_marked(tmp_path: Path) -> None:
    file, _ = begun(tmp_path)
    assert summary_of(file.path).complete is False
    (tmp_path / "x.mcap").write_text("hello")
    assert summary_of(tmp_path / "x.mcap").problem == "is not an MCAP file"


def test_a_recording_is_read_again_only_after_it_has_changed(folder: Path, monkeypatch) -> None:
    first = indexed(folder)
    assert [each.name[:10] for each in first] == ["2026-11-22", "2026-11-21", "2026-11-20"]
    read: list[str] = []
    monkeypatch.setattr(index, "_read_through", lambda path: read.append(path.name) or summary_of(path))
    assert repr(indexed(folder)) == repr(first)
    assert read == []
    os.utime(folder / first[1].name, (2e9, 1.1e9))
    indexed(folder)
    assert read == [first[1].name]
    (folder / first[0].name).unlink()
    assert len(indexed(folder)) == 2
    assert len(json.loads((folder / NAME).read_text())["runs"]) == 2


@pytest.mark.parametrize("damage", ["", "[]", '{"format": 0}', '{"format": 1, "runs": [{"name": "x"}]}', "\x00"])
def test_a_damaged_index_is_rebuilt(folder: Path, damage: str) -> None:
    first = indexed(folder)
    (folder / NAME).write_text(damage)
    assert repr(indexed(folder)) == repr(first)
    (folder / NAME).unlink()
    assert repr(indexed(folder, rebuild=True)) == repr(first)


def test_a_recording_in_progress_is_listed_and_read_later(tmp_path: Path) -> None:
    path = recording(tmp_path, *messages_of(), old=False)
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])  # it has no end yet
    (now,) = indexed(tmp_path)
    path.write_bytes(whole)
    assert now.summary.problem == "is being recorded"
    os.utime(path, (1e9, 1e9))
    (later,) = indexed(tmp_path)
    assert later.summary.problem == ""


def test_the_command_lists_searches_groups_and_compares(folder: Path, capsys) -> None:
    assert main(["runs", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert " ".join(lines[0].split()) == "run for object touched outline ± worst ± mass faults and notes"
    assert " ".join(lines[1].split()) == "2026-11-22T10-00-00Z – – – – – – is not an MCAP file"
    assert " ".join(lines[2].split()) == "2026-11-21T10-00-00Z 2 s cup 67 % 20 µm 90 µm 200.0 g pad1-silent"
    assert lines[-1] == f"3 runs in {folder}"
    assert main(["runs", str(folder), "--note", "2026-11-21", "with oil"]) == 0
    capsys.readouterr()
    assert main(["runs", str(folder), "--search", "OIL", "cup", "pad1-"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].endswith('200.0 g  pad1-silent, "with oil"')
    assert lines[2] == f"1 of 3 runs in {folder}"
    assert main(["runs", str(folder), "--objects"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "cup: 2 runs, outline within ±90 µm at best, mass 200.0 to 200.0 g"
    assert lines[3] == "not recognised: 1 run, outline within ±– at best"
    assert main(["runs", str(folder), "--compare", "2026-11-20", "2026-11-21"]) == 0
    rows = {line.split("  ")[0]: line for line in capsys.readouterr().out.splitlines()}
    assert rows["notes"].endswith("with oil")
    assert rows["faults"].count("pad1-silent") == 2
    assert main(["runs", str(folder), "--json", "--search", "oil"]) == 0
    (only,) = json.loads(capsys.readouterr().out)
    assert (only["run"], only["worst_sd_m"], only["notes"]) == ("2026-11-21T10-00-00Z.mcap", 9e-5, ["with oil"])


def test_the_beginning_of_several_names_names_no_run(folder: Path, capsys) -> None:
    assert main(["runs", str(folder), "--compare", "2026"]) == 1
    assert capsys.readouterr().err.startswith("2026: 3 runs have names that begin so")


def test_search_by_day_and_words() -> None:
    run = IndexedRun("2026-11-21T10-00-00Z.mcap", 1, 1, RunSummary(started="2026-11-21T10:00:00+00:00", object="cup"))
    assert matches(run, ["CUP", "2026-11"], "2026-11-21")
    assert not matches(run, ["CUP", "saucer"], "")
    assert not matches(run, [], "2026-11-22")


def test_a_note_replaces_the_previous_one_and_leaves_the_recording_unchanged(folder: Path) -> None:
    path = folder / "2026-11-21T10-00-00Z.mcap"
    before = path.read_bytes()
    for text in ("one", "two\nlines "):
        annotate(path, text)
    assert indexed(folder)[1].summary.notes == ("two lines",)
    assert path.read_bytes() == before
    shutil.rmtree(folder)


def test_listing_from_the_index_does_not_load_the_recording_reader(folder: Path) -> None:
    indexed(folder)
    program = (
        f"import sys; from palmd.cli import main; main(['runs', {str(folder)!r}])\n"
        "sys.exit(bool({'numpy', 'pydantic', 'mcap', 'msgpack', 'yaml'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.count("2026-11-2")) == (0, 3)
