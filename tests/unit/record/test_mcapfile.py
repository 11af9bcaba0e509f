"""Recordings as MCAP files: read by the mcap library, and truncated or damaged ones read by palmd."""

import json
import os
from io import BytesIO

import pytest
import recorded
from mcap.reader import NonSeekingReader, make_reader

from palmd.quantities import ESTIMATE, LOOP
from palmd.record import MAGIC
from palmd.record.mcapfile import Preface, RunError, RunWriter, json_schema
from palmd.record.mcapread import is_packed, read_layout, read_messages
from palmd.record.runfile import pack
from palmd.topics import TOPICS


def test_every_topic_of_the_table_has_a_schema_of_its_fields():
    for topic in TOPICS:
        schema = json_schema(topic.name)
        said = {*schema["properties"], *(f"{name[1:]}*" for name in schema.get("patternProperties", ()))}
        assert said == {"v", "timestamp", "mono_ns", "seq", *(field.name for field in topic.quantities)}
        json.dumps(schema, allow_nan=False)


def test_a_schema_gives_the_type_of_each_field():
    schema = json_schema(ESTIMATE.name)
    assert schema["properties"]["valid"]["type"] == "boolean"
    assert schema["properties"]["r1_m"] == {
        "type": "number",
        "description": "distance of palm 1 from the centre of mass (m)",
    }
    assert schema["properties"]["sd"] == {
        "type": "object",
        "additionalProperties": {"type": "number"},
        "description": "standard deviation of each field that it names, in that field's unit",
    }
    assert json_schema(LOOP.name)["patternProperties"]["^pad1_"]["type"] == "number"
    assert "r1_m" in schema["required"]


def test_a_topic_without_a_table_has_an_open_schema():
    assert json_schema("rig/truth") == {"title": "rig/truth", "type": "object"}


@pytest.fixture(params=["as it was written", "packed"])
def run(request, tmp_path):
    file, _ = recorded.begun(tmp_path)
    file.finish()
    if request.param == "packed":
        pack(file.path, file.path)
    return file.path


def test_messages_are_read_back_unchanged(run):
    assert list(read_messages(run)) == list(recorded.messages(5))


def test_the_mcap_library_reads_messages(run):
    with run.open("rb") as stream:
        read = list(make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False))
    expected = list(recorded.messages(5))
    assert [(channel.topic, one.data, one.log_time, one.publish_time, one.sequence) for _, channel, one in read] == [
        (one.topic, one.payload, one.log_time_ns, one.publish_time_ns, one.sequence) for one in expected
    ]
    for schema, channel, _ in read:
        assert (channel.message_encoding, schema.encoding, schema.name) == ("msgpack", "jsonschema", channel.topic)
        assert json.loads(schema.data) == json_schema(channel.topic)
    with run.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary.statistics.message_count == len(expected)
    assert summary.statistics.message_start_time == expected[0].log_time_ns


def test_the_mcap_library_finds_attachments(run):
    with run.open("rb") as stream:
        reader = make_reader(stream)
        assert {one.name for one in reader.iter_attachments()} == {"config.yaml", "rig.json"}
        assert [one.name for one in reader.iter_metadata()] == ["palmd"]
    with run.open("rb") as stream:
        assert len(list(NonSeekingReader(stream).iter_attachments())) == 2


def test_only_a_packed_file_is_recognised_as_packed(tmp_path):
    file, _ = recorded.begun(tmp_path)
    assert not read_layout(file.path).finished
    assert not is_packed(file.path)
    file.finish()
    assert read_layout(file.path).finished
    assert not is_packed(file.path)
    size = file.path.stat().st_size
    assert pack(file.path, tmp_path / "packed.mcap").count == 12
    assert is_packed(tmp_path / "packed.mcap")
    assert (tmp_path / "packed.mcap").stat().st_size < size
    assert {path.name for path in tmp_path.iterdir()} == {file.path.name, "packed.mcap"}


def small(stream, compressed):
    """Three messages and a short preface; returns where each message ends."""
    writer = RunWriter(stream, Preface({"palmd": {"schema": "1"}}, {"a.txt": b"abc"}), 0, compressed=compressed)
    ends = []
    for one in THREE:
        writer.write(one)
        ends.append(stream.tell())
    if compressed:
        writer.finish()
    return ends


THREE = [recorded.message("rig/truth", {"psi_rad": 0.1 * i}, i) for i in range(3)]


def test_a_file_cut_anywhere_gives_every_complete_message(tmp_path):
    stream = BytesIO()
    ends = small(stream, compressed=False)
    data, cut = stream.getvalue(), tmp_path / "cut.mcap"
    for length in range(len(MAGIC), len(data) + 1):
        cut.write_bytes(data[:length])
        layout = read_layout(cut)
        whole = sum(end <= length for end in ends)
        assert list(read_messages(cut)) == THREE[:whole], length
        assert not layout.finished
        if length > ends[0]:  # from there on there are only messages
            assert layout.damage.torn_bytes == length - ends[whole - 1]
            assert not layout.damage.damaged


def test_a_packed_file_cut_anywhere_is_read_up_to_the_cut(tmp_path):
    stream = BytesIO()
    small(stream, compressed=True)
    data, cut = stream.getvalue(), tmp_path / "cut.mcap"
    found = set()
    for length in range(len(MAGIC), len(data)):
        cut.write_bytes(data[:length])
        read = list(read_messages(cut))
        assert read in ([], THREE), length
        found.add(len(read))
        assert not read_layout(cut).finished
    assert found == {0, 3}


def test_packing_keeps_file_permissions(tmp_path):
    file, _ = recorded.begun(tmp_path)
    file.finish()
    file.path.chmod(0o640)
    if os.geteuid() == 0:
        os.chown(file.path, 1234, 1234)
    before = file.path.stat()
    pack(file.path, file.path)
    after = file.path.stat()
    assert (after.st_mode, after.st_uid, after.st_gid) == (before.st_mode, before.st_uid, before.st_gid)


def test_a_damaged_chunk_is_left_out_and_counted(tmp_path):
    file, _ = recorded.begun(tmp_path, 20)
    file.finish()
    pack(file.path, file.path)
    data = bytearray(file.path.read_bytes())
    at = data.index(b"\x28\xb5\x2f\xfd") + 40  # within the first chunk's zstd frame
    data[at] ^= 0xFF
    file.path.write_bytes(data)
    assert list(read_messages(file.path)) == []
    damage = read_layout(file.path).damage
    assert damage.damaged
    assert damage.lost_bytes > 0
    assert (damage.messages, damage.exact) == (42, True)


def test_damage_costs_only_what_is_damaged(tmp_path):
    """Damage to the preface costs its metadata, damage to a channel its messages."""
    stream, path = BytesIO(), tmp_path / "run.mcap"
    small(stream, compressed=False)
    whole = stream.getvalue()
    for at, left in ((whole.index(b"schema"), THREE), (whole.rindex(b"rig/truth"), [])):
        data = bytearray(whole)
        data[at] = 0xFF  # no longer text
        path.write_bytes(data)
        assert list(read_messages(path)) == left
        layout = read_layout(path)
        assert layout.preface.attachments == {"a.txt": b"abc"}
        assert (layout.damage.preface_bytes > 0) == (layout.preface.metadata == {}) == (left == THREE)


@pytest.mark.parametrize("content", [b"", b"palmd", b'{"palmd_log":1}\n' * 9, bytes(100_000)])
def test_a_file_that_is_no_mcap_is_rejected(tmp_path, content):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(RunError, match="is not an MCAP file"):
        list(read_messages(path))


def test_a_failed_packing_leaves_no_file(tmp_path):
    path = tmp_path / "run.mcap"
    path.write_bytes(b"palmd" * 99)
    with pytest.raises(RunError):
        pack(path, tmp_path / "packed.mcap")
    assert list(tmp_path.iterdir()) == [path]
