"""A recording with random damage: every command reads intact chunks and reports missing data."""

import json
import random
from dataclasses import replace

import pytest
import recorded
from campaign import nightly
from damaged import chunks, damage, intact_messages
from damaged import pack as pack_small
from mcap.opcode import Opcode
from mcap.writer import Writer

from palmd.cli import main
from palmd.quantities import CONFIG
from palmd.record.mcapfile import Preface
from palmd.record.mcapread import layout_of, messages_of, read_layout, read_messages
from palmd.record.mcapscan import records
from palmd.record.metadata import CONFIG as CONFIG_FILE
from palmd.record.metadata import RIG, preface, preface_of
from palmd.record.run import read_any_run
from palmd.record.runfile import pack
from palmd.rig.world import default_config

READ = 0.95  # share of the messages in intact chunks


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    pack_small(path)
    return path


@pytest.fixture(scope="module")
def unfinished(tmp_path_factory, packed):
    """As a killed recorder leaves it: without chunks, without an end."""
    path = tmp_path_factory.mktemp("unfinished") / "run.mcap"
    return recorded.written(path, read_messages(packed), read_layout(packed).preface, finish=False)


@pytest.mark.parametrize(("seed", "damages"), [(54, 60), *nightly((55, 200))])
def test_every_intact_chunk_is_read_whatever_the_damage(packed, seed, damages):
    whole = packed.read_bytes()
    parts, chance = chunks(whole), random.Random(seed)
    assert len(parts) > 15
    notices = 0
    for number in range(damages):
        data, kept = damage(whole, chance)
        layout = layout_of(data)
        messages = [] if layout is None else list(messages_of(data, layout))
        got = {(one.topic, one.sequence, one.payload) for one in messages}
        intact = intact_messages(parts, kept)
        assert len(got & intact) >= READ * len(intact), number
        assert len(got) == len(messages), f"{number}: a duplicate message"
        assert got <= set().union(*(m for _, _, m in parts)), f"{number}: an invented message"
        lost = sum(len(m) for _, _, m in parts) - len(got)
        if lost:
            said = layout is None or layout.damage.damaged or not layout.finished
            assert said, f"{number}: {lost} messages lost without a message"
            notices += 1
    assert notices > damages // 4


def test_an_unfinished_file_gives_its_intact_messages(unfinished):
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


def test_commands_continue_and_report_missing_data(packed, tmp_path, capsys):
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


def test_a_lost_preface_is_restored_from_the_stream(tmp_path):
    config = default_config()
    from palmd.config.any_config import as_yaml, config_hash

    fields = {"config_hash": config_hash(config), "yaml": as_yaml(config)}
    messages = [*recorded.messages(3), recorded.message(CONFIG.name, fields, 0)]
    path = recorded.written(tmp_path / "run.mcap", messages, preface(config, recorded.BEGIN.isoformat()))
    data = bytearray(path.read_bytes())
    at = data.index(b"palm/events") - 300
    data[8:at] = bytes(at - 8)
    path.write_bytes(data)
    run = read_any_run(path)
    assert run.config == config
    assert run.damage.preface_bytes
    assert run.layout.count == 9


@pytest.mark.parametrize("odd", [0, 2])
def test_a_message_dated_1970_gets_its_neighbours_time_and_does_not_lengthen_the_run(tmp_path, odd):
    messages = list(recorded.messages(3))
    messages[odd] = replace(messages[odd], log_time_ns=5, publish_time_ns=7)
    path = recorded.written(tmp_path / "run.mcap", messages, Preface({}, {}))
    layout = read_layout(path)
    assert 0 < layout.end_ns - layout.begin_ns < 60e9
    pack(path, path)
    for one in read_messages(path):
        assert abs(one.log_time_ns - recorded.T0 * 1e9) < 60e9
        assert abs(one.publish_time_ns - recorded.T0 * 1e9) < 60e9


def chunk_heads(data):
    """Offsets of the chunk headers of a packed file."""
    return [item.begin for item in records(data) if item.opcode == Opcode.CHUNK]


@pytest.mark.parametrize("head", [bytes(9), b"\x06" + bytes(8), b"\x06" + b"\xff" * 8])
def test_chunks_with_damaged_headers_only_are_read(packed, head):
    data = bytearray(packed.read_bytes())
    for begin in chunk_heads(bytes(data)):
        data[begin : begin + 9] = head
    layout = layout_of(bytes(data))
    assert layout.count == sum(1 for _ in messages_of(bytes(data), layout)) == read_layout(packed).count
    assert layout.damage.damaged
    assert layout.damage.messages == 0


def test_the_first_of_two_recordings_in_one_file_is_read_and_the_second_is_kept(packed, tmp_path, capsys):
    path = tmp_path / "both.mcap"
    whole = packed.read_bytes()
    path.write_bytes(whole + whole)
    assert main(["runs", "recover", str(path)]) == 1
    assert f"{len(whole):,}" in capsys.readouterr().err
    assert path.read_bytes() == whole + whole
    assert read_any_run(tmp_path / "both.recovered.mcap").layout.count == read_layout(packed).count


@pytest.mark.parametrize("chunking", [True, False])
def test_messages_of_other_programs_are_no_damage_and_are_kept(packed, tmp_path, capsys, chunking):
    """As after a filter: without metadata and attachments, with a channel of another encoding."""
    path = tmp_path / "run.mcap"
    source = read_layout(packed)
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=chunking)
        writer.start("")
        for name, values in source.preface.metadata.items():
            writer.add_metadata(name, dict(values))
        for name, content in source.preface.attachments.items():
            writer.add_attachment(0, 0, name, "text/plain", content)
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {}
        for message in read_messages(packed):
            if message.topic not in channels:
                channels[message.topic] = writer.register_channel(message.topic, "msgpack", schema)
                channels.setdefault("note", writer.register_channel("camera/note", "json", schema))
            t = message.log_time_ns
            writer.add_message(channels[message.topic], t, message.payload, t, message.sequence)
            writer.add_message(channels["note"], t, b'{"seen": 1}', t, 0)
        writer.finish()
    before = path.read_bytes()
    run = read_any_run(path)
    assert not run.damage.damaged
    assert run.layout.count == source.count
    assert run.layout.foreign == {"camera/note": source.count}
    assert main(["export", str(path), "-o", str(tmp_path / "csv"), "--as", "csv"]) == 0
    assert main(["runs", "recover", str(path)]) == (0 if chunking else 1)  # it is complete, or a packed copy is made
    assert chunking or "camera/note" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_the_rig_description_follows_from_the_configuration(packed):
    layout = read_layout(packed)
    attachments = {CONFIG_FILE: layout.preface.attachments[CONFIG_FILE]}
    found = preface_of(replace(layout, preface=Preface(layout.preface.metadata, attachments)))
    assert json.loads(found.attachments[RIG]) == json.loads(layout.preface.attachments[RIG])
