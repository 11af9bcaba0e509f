"""`palmd runs recover` and `palmd record`: what they print, and what they refuse."""

import pytest
import recorded

from palmd.cli import main
from palmd.record.mcapread import is_packed, read_messages
from palmd.record.run import read_run


@pytest.fixture
def cut_off(tmp_path):
    """A run that ends in the middle of its last message but one."""
    file, ends = recorded.begun(tmp_path)
    file.abandon()
    with file.path.open("r+b") as stream:
        stream.truncate(ends[-2] - 5)
    return file.path


def test_a_run_that_lacks_only_its_end_is_completed_in_place(tmp_path, capsys):
    file, _ = recorded.begun(tmp_path)
    file.abandon()
    assert main(["runs", "recover", str(file.path)]) == 0
    assert capsys.readouterr().out == f"{file.path}: 12 messages of 0.5 s saved\n"
    assert list(read_messages(file.path)) == list(recorded.messages(5))
    assert is_packed(file.path)
    assert read_run(file.path).complete
    assert main(["runs", "recover", str(file.path)]) == 0
    assert capsys.readouterr().out == f"{file.path}: is already complete\n"


def test_a_damaged_run_is_never_overwritten(cut_off, capsys):
    before = cut_off.read_bytes()
    saved = cut_off.with_name(f"{cut_off.stem}.recovered.mcap")
    assert main(["runs", "recover", str(cut_off)]) == 1
    out = capsys.readouterr().out
    assert out.startswith(f"{saved}: 10 messages of 0.4 s saved, ")
    assert out.endswith(" torn bytes at the end left out\n")
    assert cut_off.read_bytes() == before
    assert list(read_messages(saved)) == list(recorded.messages(5))[:-2]
    assert read_run(saved).complete
    assert main(["runs", "recover", str(cut_off), "-o", str(cut_off)]) == 1
    assert "cannot be read and would be lost" in capsys.readouterr().err
    assert cut_off.read_bytes() == before


def test_the_output_may_be_named(cut_off, tmp_path, capsys):
    before = cut_off.read_bytes()
    assert main(["runs", "recover", str(cut_off), "-o", str(tmp_path / "b.mcap")]) == 1
    assert capsys.readouterr().out.startswith(f"{tmp_path / 'b.mcap'}: 10 messages")
    assert cut_off.read_bytes() == before
    assert is_packed(tmp_path / "b.mcap")


def test_a_file_that_cannot_be_recovered_is_refused_and_left_unchanged(tmp_path, capsys):
    path = tmp_path / "run.mcap"
    path.write_bytes(b"not a recording")
    assert main(["runs", "recover", str(path)]) == 1
    assert capsys.readouterr().err == f"{path}: is not an MCAP file\n"
    assert path.read_bytes() == b"not a recording"


def test_an_output_that_cannot_be_written_is_reported(cut_off, tmp_path, capsys):
    target = tmp_path / "none" / "b.mcap"
    assert main(["runs", "recover", str(cut_off), "-o", str(target)]) == 1
    assert capsys.readouterr().err == f"{target}: cannot be written: No such file or directory\n"


def test_record_refuses_a_bad_configuration_and_a_bad_address(tmp_path, capsys):
    assert main(["record", str(tmp_path / "none.yaml")]) == 1
    assert "none.yaml" in capsys.readouterr().err
    config = tmp_path / "palmd.yaml"
    config.write_text(
        "pads: {palm1: {port: a}, palm2: {port: b}}\narm: {port: c}\n"
        f"bus: {{publish: 'ipc://{tmp_path}/p', command: 'ipc://{tmp_path}/c'}}\n"
    )
    assert main(["record", str(config), "--truth", "somewhere"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("somewhere: not an address (")
    assert error.endswith("; one looks like tcp://127.0.0.1:9872\n")
