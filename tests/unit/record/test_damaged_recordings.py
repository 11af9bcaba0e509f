"""A recording that is damaged at random: every command reads what is intact, and says what is missing."""

import json
import random
from pathlib import Path

import pytest
import recorded
from damaged import chunks, damage, intact_messages
from damaged import pack as pack_small

from palmd.cli import main
from palmd.quantities import CONFIG
from palmd.record.mcapfile import Preface, RawMessage, RunWriter
from palmd.record.mcapread import layout_of, messages_of, read_layout, read_messages
from palmd.record.metadata import preface
from palmd.record.run import RunError, read_any_run
from palmd.record.runfile import pack
from palmd.rig.world import default_config

DAMAGES = 200
READ = 0.95  # of what lies in intact chunks


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    pack_small(path)
    return path


@pytest.fixture(scope="module")
def unfinished(tmp_path_factory, packed):
    """As a killed recorder leaves it: without chunks, without an end."""
    path = tmp_path_factory.mktemp("unfinished") / "run.mcap"
    with path.open("wb") as stream:
        writer = RunWriter(stream, read_layout(packed).preface, 0, compressed=False)
        for message in read_messages(packed):
            writer.write(message)
    return path


def test_every_intact_chunk_is_read_whatever_the_damage(packed):
    whole = packed.read_bytes()
    parts, chance = chunks(whole), random.Random(54)
    assert len(parts) > 15
    told = 0
    for number in range(DAMAGES):
        data, kept = damage(whole, chance)
        layout = layout_of(data)
        messages = [] if layout is None else list(messages_of(data, layout))
        got = {(one.topic, one.sequence, one.payload) for one in messages}
        intact = intact_messages(parts, kept)
        assert len(got & intact) >= READ * len(intact), number
        assert len(got) == len(messages), f"{number}: a message twice"
        assert got <= set().union(*(m for _, _, m in parts)), f"{number}: a message that never was"
        lost = sum(len(m) for _, _, m in parts) - len(got)
        if lost:
            said = layout is None or layout.damage.damaged or not layout.finished
            assert said, f"{number}: {lost} messages lost without a word"
            told += 1
    assert told > DAMAGES // 4


def test_an_unfinished_file_gives_what_is_intact(unfinished):
    whole = unfinished.read_bytes()
    all_of_it = {(one.topic, one.sequence, one.payload) for one in read_messages(unfinished)}
    chance = random.Random(55)
    for number in range(12):
        data, kept = damage(whole, chance)
        layout = layout_of(data)
        messages = [] if layout is None else list(messages_of(data, layout))
        got = {(one.topic, one.sequence, one.payload) for one in messages}
        share = sum(end - begin for begin, end in kept if end > begin) / len(whole)
        assert len(got & all_of_it) >= 0.97 * min(share, 1.0) * len(all_of_it) - 60, number
        assert len(got - all_of_it) <= 1, f"{number}: only a flip within a number goes unnoticed"


def test_the_commands_go_on_and_say_what_is_missing(packed, tmp_path, capsys):
    data = bytearray(packed.read_bytes())
    begin, end, lost = chunks(bytes(data))[8]
    data[(begin + end) // 2] ^= 0xFF
    folder = tmp_path / "runs"
    folder.mkdir()
    run = folder / "run.mcap"
    run.write_bytes(data)
    expected = f"{len(lost)} messages are missing"
    for words in (
        ["export", str(run), "-o", str(tmp_path / "csv")],
        ["why", str(run)],
        ["report", str(run), "-o", str(tmp_path / "r.html")],
    ):
        assert main(words) == 0, words
        said = capsys.readouterr()
        assert said.err.count(expected) == 1, words
    rows = sum(len(file.read_text().splitlines()) - 1 for file in (tmp_path / "csv").iterdir())
    assert rows == read_layout(packed).count - len(lost)
    assert main(["runs", str(folder), "--json"]) == 0
    assert expected in json.loads(capsys.readouterr().out)[0]["damage"]
    assert main(["runs", "recover", str(run)]) == 1
    saved = read_any_run(folder / "run.recovered.mcap")
    assert saved.complete
    assert not saved.damage.damaged
    assert saved.layout.count == rows
    assert run.read_bytes() == bytes(data)


def test_a_lost_preface_is_taken_from_the_stream(tmp_path):
    config = default_config()
    from palmd.config.any_config import as_yaml, config_hash

    told = {"config_hash": config_hash(config), "yaml": as_yaml(config)}
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = RunWriter(stream, preface(config, recorded.BEGIN.isoformat()), 0, compressed=False)
        for message in recorded.messages(3):
            writer.write(message)
        writer.write(recorded.message(CONFIG.name, told, 0))
        writer.finish()
    data = bytearray(path.read_bytes())
    at = data.index(b"palm/events") - 300
    data[8:at] = bytes(at - 8)
    path.write_bytes(data)
    run = read_any_run(path)
    assert run.config == config
    assert run.damage.preface_bytes
    assert run.layout.count == 9


def test_what_is_dated_1970_gets_the_time_of_its_neighbours(tmp_path):
    path = tmp_path / "run.mcap"
    messages = list(recorded.messages(3))
    odd = messages[2]
    messages[2] = RawMessage(odd.topic, 5, 7, odd.sequence, odd.payload)
    with path.open("wb") as stream:
        writer = RunWriter(stream, Preface({}, {}), 0, compressed=False)
        for message in messages:
            writer.write(message)
        writer.finish()
    pack(path, path)
    for one in read_messages(path):
        assert abs(one.log_time_ns - recorded.T0 * 1e9) < 60e9
        assert abs(one.publish_time_ns - recorded.T0 * 1e9) < 60e9


def test_a_file_of_nothing_is_refused(tmp_path):
    path = Path(tmp_path / "zero.mcap")
    path.write_bytes(bytes(100_000))
    with pytest.raises(RunError, match="is no MCAP file"):
        read_any_run(path)
