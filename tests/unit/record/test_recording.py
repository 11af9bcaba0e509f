"""Which messages go to which file, and what happens when the disk cannot be written."""

import errno
import os

import pytest
import recorded

from palmd.config.any_config import as_yaml, config_hash
from palmd.messages import events_fields
from palmd.quantities import CONFIG, EVENTS
from palmd.record import runfile
from palmd.record.mcapread import read_layout, read_messages
from palmd.record.recording import MAX_FILE_S, RETRY_S, SILENT_S, Recording
from palmd.record.run import read_any_run

T0 = recorded.T0


class Disk:
    """A recording into a folder, and the files that it has closed."""

    def __init__(self, folder):
        self.ended = []
        self.folder = folder
        self.recording = Recording(recorded.config(folder), self.ended.append)

    def take(self, number, t=0.0, topic=EVENTS.name):
        self.recording.take(recorded.frames(topic, events_fields(t, []), number, t), T0 + t)
        self.recording.flush(T0 + t)

    def files(self):
        return sorted(path.name for path in self.folder.iterdir())

    def numbers(self, path):
        return [message.sequence for message in read_messages(path)]


@pytest.fixture
def disk(tmp_path):
    return Disk(tmp_path / "runs")


def test_flushed_messages_are_in_the_file(disk):
    for number in range(3):
        disk.take(number)
        assert disk.numbers(disk.recording.path) == list(range(number + 1))
    assert disk.files() == ["2026-11-21T22-30-05Z.mcap"]
    assert disk.recording.messages == 3
    assert disk.recording.size_bytes == disk.recording.path.stat().st_size


def test_bytes_and_times_are_stored_unchanged(disk):
    sent = recorded.frames(EVENTS.name, events_fields(0.5, recorded.events(1)), 0, 0.5)
    disk.recording.take(sent, T0 + 0.75)
    disk.recording.flush(T0 + 0.75)
    (got,) = read_messages(disk.recording.path)
    assert (got.topic.encode(), got.payload) == (sent[0], sent[1])
    assert got.log_time_ns == round((T0 + 0.75) * 1e9)
    assert got.publish_time_ns == round((T0 + 0.5) * 1e9)


def test_gaps_are_counted_for_each_topic(disk):
    for number, topic in ((0, "palm/a"), (7, "palm/b"), (1, "palm/a"), (9, "palm/b"), (5, "palm/a"), (10, "palm/b")):
        disk.take(number, topic=topic)
    assert disk.recording.lost == 1 + 3
    assert disk.recording.messages == 6


def test_a_restarted_daemon_gets_a_new_file(disk):
    for number in (0, 1, 2):
        disk.take(number)
    disk.take(0, 0.4)
    assert disk.files() == ["2026-11-21T22-30-05Z-2.mcap", "2026-11-21T22-30-05Z.mcap"]
    (first,) = disk.ended
    assert (first.messages, first.whole, disk.numbers(first.path)) == (3, True, [0, 1, 2])
    assert disk.numbers(disk.recording.path) == [0]
    assert disk.recording.lost == 0
    assert read_layout(disk.recording.path).preface.metadata["palmd"]["continues"] == ""


def test_a_restarted_rig_does_not_start_a_new_file(disk):
    disk.take(0)
    disk.take(500, topic="rig/truth")
    disk.take(0, topic="rig/truth")
    assert disk.ended == []
    assert disk.recording.lost == 0


def test_only_the_daemon_begins_a_file(disk):
    disk.take(0, topic="rig/truth")
    assert disk.recording.path is None
    assert not disk.folder.exists()
    disk.take(0)
    disk.take(1, topic="rig/truth")
    assert disk.recording.messages == 2
    assert disk.recording.lost == 0


def test_a_long_run_continues_in_another_file(disk):
    disk.take(0)
    disk.take(1, MAX_FILE_S - 1)
    disk.take(2, MAX_FILE_S)
    (first,) = disk.ended
    assert (disk.numbers(first.path), read_layout(first.path).finished) == ([0, 1], True)
    assert disk.recording.path.name == "2026-11-21T23-30-05Z.mcap"
    assert read_layout(disk.recording.path).preface.metadata["palmd"]["continues"] == first.path.name
    assert disk.recording.lost == 0


def test_a_run_ends_when_the_daemon_falls_silent_and_continues_when_it_sends_again(disk):
    disk.take(0)
    for tenths in range(1, round(SILENT_S * 10)):
        disk.take(tenths, 0.1 * tenths, topic="rig/truth")
    assert disk.ended == []
    disk.take(50, SILENT_S + 0.1, topic="rig/truth")
    assert [one.whole for one in disk.ended] == [True]
    assert disk.recording.path is None
    disk.take(3, SILENT_S + 1.0)
    assert disk.recording.lost == 2
    assert read_layout(disk.recording.path).preface.metadata["palmd"]["continues"] == disk.ended[0].path.name


@pytest.mark.parametrize(
    "frames",
    [[b"palm/x"], [b"palm/x", b"\xc1", b"1"], [b"palm/x", b"\x93\x01\x02\x03", b"1"], [b"palm/x", b"\x80", b"1"]],
)
def test_invalid_messages_are_left_out(disk, frames):
    disk.recording.take(frames, T0)
    assert disk.recording.path is None


@pytest.mark.parametrize("timestamp", [float("nan"), float("inf"), -1.0, 0.0, "now", None])
def test_an_invalid_timestamp_is_replaced_by_the_time_of_arrival(disk, timestamp):
    payload = recorded.msgpack.packb({"seq": 0, "timestamp": timestamp})
    disk.recording.take([EVENTS.name.encode(), payload, b""], T0)
    disk.recording.flush(T0)
    (message,) = read_messages(disk.recording.path)
    assert message.publish_time_ns == message.log_time_ns == round(T0 * 1e9)
    assert message.payload == payload


# ------------------------------------------------------------------------------------------------ write errors


@pytest.fixture
def full(monkeypatch):
    """A disk that can be filled up in mid-write: `full.room` bytes fit until it is None."""

    class Full:
        room = None

    real = os.write

    def write(fd, data):
        if Full.room is None:
            return real(fd, data)
        if Full.room == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = real(fd, data[: Full.room])
        Full.room -= written
        return written

    monkeypatch.setattr(runfile.os, "write", write)
    return Full


def test_a_full_disk_keeps_its_files_and_writing_is_retried(disk, full):
    for number in range(3):
        disk.take(number, 0.01 * number)
    full.room = 100  # in the middle of a record
    disk.take(3, 0.03)
    (first,) = disk.ended
    assert (first.whole, first.messages, disk.numbers(first.path)) == (False, 3, [0, 1, 2])
    assert disk.recording.problem == f"{disk.folder}: the disk is full"
    assert disk.recording.lost == 1
    disk.take(4, 1.0)
    full.room = None
    disk.take(5, RETRY_S)
    assert (disk.recording.lost, disk.recording.path) == (3, None)
    disk.take(6, RETRY_S + 0.1)
    assert disk.recording.problem == ""
    assert disk.numbers(disk.recording.path) == [6]
    assert disk.recording.lost == 3
    assert read_layout(disk.recording.path).preface.metadata["palmd"]["continues"] == first.path.name


def test_a_file_complete_to_its_last_record_can_be_packed(disk, full):
    for number in range(3):
        disk.take(number)
    full.room = 7
    disk.recording.finish()
    (first,) = disk.ended
    assert not first.whole
    full.room = None
    assert runfile.pack(first.path, first.path).count == 3
    assert read_layout(first.path).finished


def test_a_disk_full_from_the_beginning_gets_no_empty_files(disk, full):
    full.room = 10
    for number in range(3):
        disk.take(number)
    assert disk.files() == []
    assert disk.recording.lost == 3
    assert "the disk is full" in disk.recording.problem


def test_an_unwritable_folder_is_reported_and_retried(disk, caplog):
    disk.folder.write_text("a file where the directory should be")
    for number in range(3):
        disk.take(number)
    assert disk.recording.problem == f"{disk.folder}: File exists"
    assert disk.recording.lost == 3
    assert caplog.text.count("retrying every") == 1
    disk.folder.unlink()
    disk.take(3, RETRY_S)
    assert disk.recording.problem == ""
    assert disk.numbers(disk.recording.path) == [3]


def test_after_a_later_write_error_the_file_is_not_used_again(disk):
    disk.take(0)
    disk.recording.fail(OSError(errno.EIO, "Input/output error"), T0)
    assert disk.recording.problem.endswith("Input/output error")
    assert disk.recording.path is None
    assert disk.numbers(disk.ended[0].path) == [0]


def test_the_daemons_configuration_is_stored_and_not_the_recorders(disk, caplog):
    config = recorded.config(disk.recording._directory)
    other = config.model_copy(update={"rig": config.rig.model_copy(update={"gravity_m_s2": 1.6})})
    published = {"config_hash": config_hash(other), "yaml": as_yaml(other)}
    disk.recording.take(recorded.frames("palm/state", {"state": "idle"}, 0), T0)
    disk.recording.take(recorded.frames(CONFIG.name, published, 0), T0)
    disk.recording.take(recorded.frames("palm/state", {"state": "idle"}, 1), T0 + 0.1)
    disk.recording.flush(T0 + 0.1)
    path = disk.recording.path
    run = read_any_run(path)
    assert run.config.rig.gravity_m_s2 == 1.6
    assert run.metadata["config_hash"] == config_hash(other)
    assert disk.numbers(path) == [0, 0, 1]
    assert "rig.gravity_m_s2" in caplog.text
    assert list(path.parent.iterdir()) == [path]


def test_a_file_begins_with_any_systems_first_message(disk):
    disk.recording.take(recorded.frames("palm3/estimate", {}, 0), T0)
    disk.recording.flush(T0)
    assert disk.numbers(disk.recording.path) == [0]
