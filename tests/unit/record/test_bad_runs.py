"""Recordings that cannot be used: each gives a one-line error with the file's name and changes nothing."""

import pytest
import recorded
import rig_recording

from palmd.cli import main
from palmd.quantities import ESTIMATE, IMPROVEMENT
from palmd.record import RunError
from palmd.record.mcapfile import Preface
from palmd.record.metadata import METADATA
from palmd.record.run import read_run
from palmd.system.rig_constants import RIG_NAMES

FILES = ("schema", "truncated", "prose", "empty", "magic", "folder", "none", "foreign", "eventless", "unconfigured")
ERRORS = {
    "schema": "has messages of schema 7; this palmd reads schema 1",
    "truncated": "is truncated before its first message: there is nothing left in it",
    "prose": "is not an MCAP file",
    "empty": "is not an MCAP file",
    "magic": "is truncated before its first message: there is nothing left in it",
    "folder": "is a folder; name a recording in it: `palmd runs FOLDER` lists them",
    "none": "no such file; `palmd runs FOLDER` lists the recordings in a folder",
    "foreign": "is an MCAP file, but not a recording of palmd",
    "eventless": "holds no palm/events",
    "unconfigured": "holds no configuration: neither the attached file config.yaml nor a palm/config message",
}
COMMANDS = {
    "estimate": ["-o", "OUT"],
    "reconstruct": ["-o", "OUT"],
    "export": ["-o", "OUT", "--as", "log"],
    "replay": ["--check"],
}


def written(path, topics=(), attached=True, **metadata):
    run = read_run(rig_recording.path())
    said = {METADATA: {**run.metadata, **metadata}} if metadata != {"none": True} else {}
    recorded.written(path, run.messages(*topics), Preface(said, run.preface.attachments if attached else {}))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    written(folder / "schema.mcap", schema="7")
    written(folder / "foreign.mcap", none=True)
    written(folder / "eventless.mcap", topics=(ESTIMATE.name, "palm/info"))
    written(folder / "unconfigured.mcap", attached=False)
    (folder / "truncated.mcap").write_bytes(rig_recording.path().read_bytes()[:60])
    (folder / "prose.mcap").write_text("a run of last week\n")
    (folder / "empty.mcap").touch()
    (folder / "magic.mcap").write_bytes(rig_recording.path().read_bytes()[:8])
    (folder / "folder.mcap").mkdir()
    return folder


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", FILES)
def test_an_unusable_recording_is_a_one_line_error(folder, tmp_path, capsys, command, name):
    path, out = folder / f"{name}.mcap", tmp_path / "out"
    arguments = [str(out) if each == "OUT" else each for each in COMMANDS[command]]
    assert main([command, str(path), *arguments]) == 1
    said, err = capsys.readouterr()
    assert (said, err) == ("", f"{path}: {ERRORS[name]}\n")
    assert not out.exists()


def test_a_recording_is_recognised_by_its_content(tmp_path, capsys):
    named = tmp_path / "run.jsonl"
    named.write_bytes(rig_recording.path().read_bytes())
    outs = tmp_path / "a", tmp_path / "b"
    for source, out in zip((named, rig_recording.path()), outs, strict=True):
        assert main(["estimate", str(source), "-o", str(out), "--observer", "quasistatic"]) == 0
    assert outs[0].read_bytes() == outs[1].read_bytes()
    assert capsys.readouterr().err == ""


def test_an_event_log_is_no_recording(tmp_path, capsys):
    log = tmp_path / "run.jsonl"
    assert main(["export", str(rig_recording.path()), "-o", str(log)]) == 0
    for command in (["replay", str(log)], ["export", str(log), "-o", str(tmp_path / "out.zip")]):
        assert main(command) == 1
        assert capsys.readouterr().err == f"{log}: is not an MCAP file\n"


@pytest.mark.parametrize("command", ["estimate", "export"])
def test_the_intact_part_of_a_cut_off_run_is_used_with_a_note(tmp_path, capsys, command):
    file, ends = recorded.begun(tmp_path)
    file.abandon()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.path.read_bytes()[: ends[6] + 11])
    assert main([command, str(cut), "-o", str(tmp_path / "out.jsonl")]) == 0
    err = capsys.readouterr().err
    assert err.startswith(f"{cut}: the recording was not finished; its messages up to the end are ")
    assert err.count("\n") == 1


def test_reconstruct_accepts_a_run_or_its_event_log(tmp_path):
    # too short for an answer, with the same reason
    log = tmp_path / "run.jsonl"
    assert main(["export", str(rig_recording.path()), "-o", str(log)]) == 0
    outs = tmp_path / "a", tmp_path / "b"
    for source, out in zip((rig_recording.path(), log), outs, strict=True):
        assert main(["reconstruct", str(source), "-o", str(out)]) == 0
    first, second = (out.read_text().rsplit('"seconds"', 1)[0] for out in outs)
    assert first == second


def test_an_invalid_improvement_is_a_one_line_error(tmp_path):
    path = tmp_path / "run.mcap"
    run = read_run(rig_recording.path())
    fields = {"t_tick_s": 0.0, "t_s": 0.0, "x": [1.0, 2.0], "covariance": [1.0]}
    fields |= {"frame": 1, "established": True, "touched": [0], "rig": [0.0] * len(RIG_NAMES), "spread": [1.0, 2.0]}
    recorded.written(path, [recorded.message(IMPROVEMENT.name, fields, 0)], run.preface)
    with pytest.raises(RunError, match=f"^{path}: {IMPROVEMENT.name}, message 0: "):
        list(read_run(path).improvements())
