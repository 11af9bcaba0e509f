"""The recorder as a process beside the real daemon: nothing is missing, whichever process ends."""

import signal
import time
from pathlib import Path

import pytest
from harness import Bench, Process, palmd, wait
from mcap.reader import make_reader

from palmd.record.mcapread import is_packed
from palmd.record.run import read_run

pytestmark = pytest.mark.rig

LOST_AT_MOST_S = 0.1


@pytest.fixture
def recorded(tmp_path):
    bench = Bench(tmp_path, record=True)
    yield bench
    bench.close()


def path_of_the_run(bench):
    """The path that the recorder reports."""
    recorder = wait(lambda: bench.client.do("status").get("recorder"), "the recorder's voice", pause_s=0.1)
    assert "problem" not in recorder
    return Path(wait(lambda: bench.client.do("status")["recorder"].get("path"), "a file", pause_s=0.1))


def packed(path):
    """The recording, once the recorder has packed it."""
    wait(lambda: is_packed(path), f"{path} packed")
    wait(lambda: {*path.parent.glob(".*")} <= {*path.parent.glob(".*.lock")}, "the end of temporary files")
    return read_run(path)


def test_a_recording_is_complete_whether_the_daemon_ends_or_is_killed(recorded):
    path = path_of_the_run(recorded)
    recorded.ticks(300)
    assert recorded.daemon.end() == 0
    recorded.drain(0.5)
    heard = recorded.heard.latest
    run = packed(path)
    assert run.complete
    survey = run.survey()
    assert set(heard) == set(survey)
    for topic, found in survey.items():
        assert (found.first, found.missing) == (0, 0), topic
        assert found.count == heard[topic]["seq"] + 1, topic
    count = 0
    for message in run.messages():
        if message.topic == "palm/loop":
            assert message.fields["bus_published"] == count
        count += 1
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_summary().statistics.message_count == count
        assert sum(1 for _ in reader.iter_messages()) == count

    recorded.start_daemon(record=True)
    second = path_of_the_run(recorded)
    assert second != path
    recorded.ticks(50)
    recorded.daemon.stop()
    found = packed(second).survey()["palm/estimate"]
    assert found.count >= 50
    assert (found.first, found.missing) == (0, 0)


def test_a_killed_recorder_loses_almost_nothing_and_disturbs_nothing(light_bench, tmp_path):
    recorder = light_bench.begin("recorder", "record", light_bench.path)
    path = path_of_the_run(light_bench)
    light_bench.ticks(100)
    seen = light_bench.heard.latest["palm/events"]["seq"]
    time.sleep(LOST_AT_MOST_S)
    recorder.end(signal.SIGKILL)
    run = read_run(path)
    assert not run.complete
    last = run.survey()["palm/events"]
    assert last.first + last.count > seen
    assert last.missing == 0

    light_bench.until_faults("recorder-silent")
    messages = sum(1 for _ in run.messages())
    done = palmd("runs", "recover", path)
    assert done.returncode == 0, done.stderr
    assert f"{path}: {messages} messages of" in done.stdout
    assert is_packed(path)

    second = light_bench.begin("recorder", "record", light_bench.path)
    light_bench.until_gone("recorder-silent")
    other = path_of_the_run(light_bench)
    assert other != path
    assert second.end() == 0
    assert read_run(other).complete
    light_bench.judge()


@pytest.mark.nightly
def test_a_directory_that_cannot_be_written_is_a_reported_fault(light_bench, tmp_path):
    (tmp_path / "runs").write_text("in the way")
    recorder = light_bench.begin("recorder", "record", light_bench.path)
    light_bench.until_faults("recorder-failed")
    status = light_bench.client.do("status")["recorder"]
    assert status["problem"] == f"{tmp_path / 'runs'}: File exists"
    assert "path" not in status
    light_bench.ticks(100)
    light_bench.judge()
    assert recorder.end() == 0
    assert recorder.all_said.count("File exists") == 1


def test_a_recorder_without_a_daemon_waits_and_leaves_no_file(tmp_path):
    (tmp_path / "palmd.yaml").write_text(
        "pads: {palm1: {port: a}, palm2: {port: b}}\narm: {port: c}\n"
        f"bus: {{publish: 'ipc://{tmp_path}/p', command: 'ipc://{tmp_path}/c'}}\n"
    )
    recorder = Process(["record", tmp_path / "palmd.yaml"], tmp_path)
    try:
        assert recorder.first_line() == f"listening to ipc://{tmp_path}/p"
        assert recorder.end() == 0
    finally:
        recorder.stop()
    assert not (tmp_path / "runs").exists()
