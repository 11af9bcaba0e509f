"""Logs of other systems than two palms: which system reads a log, and errors."""

import json

import pytest

import palmd
from palmd.cli import main
from palmd.record.eventlog import LogError, read_log
from palmd.record.logline import BadLineError
from palmd.record.systems import System, read_log_of_any, system_of
from palmd.rig.simulate import simulate_log
from palmd.systems import SYSTEMS, TWO_PALMS


@pytest.fixture
def log(tmp_path):
    """Writes a short log of two palms whose line 1 names this system."""

    def write(system):
        header, *events = simulate_log("nominal", 1, 0.05)[0]
        header["rig"] |= {} if system is None else {"system": system}
        path = tmp_path / "run.jsonl"
        path.write_text("".join(json.dumps(line) + "\n" for line in [header, *events]))
        return path

    return write


def test_each_system_of_the_table_can_be_found_by_name():
    for name in SYSTEMS:
        system: System = system_of(None if name == TWO_PALMS else name)
        assert system.name == name


def test_a_log_that_names_no_system_is_of_two_palms(log):
    path = log(None)
    system, run = read_log_of_any(path)
    assert system.name == TWO_PALMS
    assert run == read_log(path)


@pytest.mark.parametrize(("system", "shown"), [("sledge", '"sledge"'), (TWO_PALMS, '"two_palms"'), ("", '""')])
def test_an_unknown_system_is_a_one_sentence_error(system, shown, log, tmp_path, capsys):
    path, out = log(system), tmp_path / "out.json"
    for command in ("reconstruct", "estimate"):
        assert main([command, str(path), "-o", str(out)]) == 1
        err = capsys.readouterr().err
        assert f"{path}:1: rig.system is {shown}, which this palmd does not know; known systems: " in err
        assert all(name in err for name in SYSTEMS if name != TWO_PALMS)
        assert err.count("\n") == 1
    assert not out.exists()
    with pytest.raises(palmd.PalmdError, match="which this palmd does not know"):
        palmd.open(path)


def test_a_system_is_described_by_its_name(log):
    with pytest.raises(LogError, match=r":1: rig\.system must be a name, got 3"):
        read_log_of_any(log(3))


def test_commands_for_two_palms_refuse_other_systems(log):
    with pytest.raises(LogError, match="this command needs a log of two palms"):
        read_log(log("pivot"))
    with pytest.raises(BadLineError):
        system_of("sledge")
