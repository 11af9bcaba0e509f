"""`palmd replay`: the same frames again at their pace, and the same estimates to the last bit."""

import contextlib
import dataclasses
import math
import re
import signal
import subprocess
import sys
import threading
import time

import msgpack
import plotjuggler
import pytest
import recorded
import rig_recording
import zmq

from palmd.cli import main
from palmd.harness.rules import check_run
from palmd.quantities import ESTIMATE, EVENTS, IMPROVEMENT, LOG, REPLAY
from palmd.record.mcapfile import Preface, RawMessage, RunWriter
from palmd.record.metadata import METADATA
from palmd.record.player import frames, offsets, play
from palmd.record.recheck import Recheck, differences
from palmd.record.run import read_run
from tools.published import validate


def rewritten(path, change=lambda message: message, **metadata):
    """The recorded run with each message changed, left out where None, and other metadata."""
    run = read_run(rig_recording.path())
    said = {METADATA: {**run.metadata, **metadata}}
    with path.open("wb") as stream:
        writer = RunWriter(stream, Preface(said, run.preface.attachments), 0, compressed=True)
        for message in filter(None, map(change, run.messages())):
            writer.write(message)
        writer.finish()
    return path


def with_field(name, value):
    """Changes this field of the estimate in tick 120."""

    def change(message):
        if message.topic != ESTIMATE.name or message.sequence != 120:
            return message
        fields = message.fields
        fields[name] = value(fields[name])
        return dataclasses.replace(message, payload=msgpack.packb(fields))

    return change


def without(topic, *numbers):
    return lambda message: None if message.topic == topic and (not numbers or message.sequence in numbers) else message


# ------------------------------------------------------------------------------------------- checking a run again


def tick_count():
    """The number of ticks of the recorded run."""
    return sum(topic == EVENTS.name for topic, _ in rig_recording.published())


def test_without_the_smoothers_messages_the_estimates_differ(tmp_path):
    path = rewritten(tmp_path / "a.mcap", without(IMPROVEMENT.name))
    assert any(tick.differences for tick in Recheck(read_run(path)).ticks())


def test_check_reports_agreement(capsys):
    count = tick_count()
    estimates = [fields for topic, fields in rig_recording.published() if topic == ESTIMATE.name]
    assert any(fields["valid"] for fields in estimates)  # otherwise the comparison is empty
    assert any(topic == IMPROVEMENT.name for topic, _ in rig_recording.published())
    assert main(["replay", str(rig_recording.path()), "--check"]) == 0
    out, err = capsys.readouterr()
    first, second = out.splitlines()
    assert first == f"{rig_recording.path()}: {count} of {count} ticks agree to the last bit"
    assert re.fullmatch(r"the lifecycle's rules hold in \d+ states and \d+ entries of the log", second)
    assert err == ""


def without_granted(command):
    """Marks this command as refused in the log."""

    def change(message):
        if message.topic != LOG.name:
            return message
        fields = message.fields
        entries = zip(fields["name"], fields["text"], strict=True)
        fields["text"] = ["no" if name == command and text == "done" else text for name, text in entries]
        return dataclasses.replace(message, payload=msgpack.packb(fields))

    return change


def test_a_transition_without_its_command_breaks_a_rule(tmp_path, capsys):
    for command, rule in (
        ("arm", "ready to tracking without a granted arm"),
        ("start", "without a granted start"),
    ):
        path = rewritten(tmp_path / f"{command}.mcap", without_granted(command))
        assert any(rule in each for each in check_run(read_run(path)).broken)
    assert main(["replay", str(path), "--check"]) == 1
    assert rule in capsys.readouterr().out


def test_a_run_without_a_log_breaks_no_rule(tmp_path):
    kept = check_run(read_run(rewritten(tmp_path / "a.mcap", without(LOG.name))))
    assert kept.states > 10
    assert (kept.entries, kept.broken) == (0, ())


def test_a_difference_of_one_bit_is_found(tmp_path, capsys):
    path = rewritten(tmp_path / "a.mcap", with_field("s1_m", lambda s: math.nextafter(s, 1.0)))
    assert main(["replay", str(path), "--check"]) == 1
    lines = capsys.readouterr().out.splitlines()
    count = tick_count()
    assert lines[0].endswith(f"{count - 1} of {count} ticks agree to the last bit")
    assert lines[1].startswith("first difference in tick 120: s1_m was 0.0")
    assert lines[2].startswith("largest difference in tick 120: s1_m by ")


def test_an_estimate_that_the_daemon_left_out_is_no_difference():
    now = {"valid": True, "r1_m": math.nan, "sd": {}}
    assert not list(differences(3, now | {"valid": False}, now))
    assert [each.name for each in differences(3, now, now | {"valid": False})] == ["valid"]


def test_a_difference_is_given_in_standard_deviations():
    recorded_fields = {"r1_m": 1.0, "mu": 0.2, "sd": {"r1_m": 0.5, "mu": math.nan}}
    now = {"r1_m": 1.25, "mu": 0.3, "sd": {"r1_m": 0.25, "mu": math.nan}}
    found = {each.name: each.sigmas for each in differences(3, recorded_fields, now)}
    assert found["r1_m"] == 0.5
    assert math.isnan(found["mu"])
    assert set(found) == {"r1_m", "mu", "sd.r1_m"}


def test_other_versions_are_reported(tmp_path, capsys):
    path = rewritten(tmp_path / "a.mcap", without(EVENTS.name, *range(30, tick_count())), numpy="1.0", machine="abacus")
    assert main(["replay", str(path), "--check"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[1].split(",")[0] for line in lines] == [
        "recorded with numpy 1.0",
        "recorded with machine abacus",
    ]


def test_ticks_before_a_gap_are_checked(tmp_path, capsys):
    path = rewritten(tmp_path / "a.mcap", without(EVENTS.name, 150))
    assert main(["replay", str(path), "--check"]) == 0
    rest = tick_count() - 151  # after the missing tick
    said = f"150 of 150 ticks agree to the last bit; {rest} more could not be compared"
    assert said in capsys.readouterr().out


def test_a_run_without_its_beginning_cannot_be_checked(tmp_path, capsys):
    path = rewritten(tmp_path / "a.mcap", without(EVENTS.name, 0, 1))
    assert main(["replay", str(path), "--check"]) == 1
    err = capsys.readouterr().err
    assert err == f"{path}: begins with tick 2; the observer's state before is not recorded\n"


# ----------------------------------------------------------------------------------------------- publishing again


@contextlib.contextmanager
def subscriber(address, *topics):
    """A subscriber to these topics, by default to all that a run may contain."""
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.linger, socket.rcvhwm, socket.reconnect_ivl = 0, 0, 5
        socket.connect(address)
        for topic in topics or (b"palm/", b"rig/"):
            socket.subscribe(topic)
        yield socket


def heard(socket, count):
    found = []
    while len(found) < count and socket.poll(10_000):
        found.append(socket.recv_multipart())
    return found


def test_a_replay_sends_the_same_frames_in_the_same_order(tmp_path):
    address = f"ipc://{tmp_path}/publish"
    wanted = [
        [topic.encode(), msgpack.packb(fields), b"%.6f" % fields["timestamp"]]
        for topic, fields in rig_recording.published()
    ]
    with subscriber(address) as socket:
        assert main(["replay", str(rig_recording.path()), "--speed", "50", "--publish", address]) == 0
        found = heard(socket, len(wanted))
        assert not socket.poll(0)
    assert found == wanted
    assert not any(map(plotjuggler.problems, found))


def message(t, topic="palm/info"):
    return RawMessage(topic, round(t * 1e9), round(t * 1e9), 0, b"\x80")


def test_messages_are_due_at_the_pace_of_their_arrival():
    due = [t for t, _ in offsets([message(t) for t in (100.0, 100.25, 100.25, 101.0)], 2.0)]
    assert due == pytest.approx([0.0, 0.125, 0.125, 0.5])


def test_a_clock_step_does_not_delay_a_replay():
    due = [t for t, _ in offsets([message(t) for t in (100.0, 50.0, 51.0, 90_000.0, 90_000.5)], 1.0)]
    assert due == pytest.approx([0.0, 0.0, 1.0, 6.0, 6.5])


def test_nothing_is_sent_early():
    sent = []
    start = time.monotonic()
    play([message(t) for t in (0.0, 0.2)], 2.0, lambda _: sent.append(time.monotonic() - start), lambda: False, print)
    assert len(sent) == 2
    assert sent[1] >= 0.1


def test_a_replay_can_be_stopped_while_it_waits():
    sent = []
    play([message(0.0), message(4.0)], 1e-3, sent.append, lambda: bool(sent), lambda _: None)
    assert len(sent) == 1


def test_a_message_without_a_timestamp_counts_from_its_publication_time():
    assert frames(message(1.5e9)) == (b"palm/info", b"\x80", b"1500000000.000000")


def test_a_port_in_use_is_a_one_line_error(capsys):
    with zmq.Context() as context, context.socket(zmq.PUB) as socket:
        port = socket.bind_to_random_port("tcp://127.0.0.1")
        address = f"tcp://127.0.0.1:{port}"
        assert main(["replay", str(rig_recording.path()), "--publish", address]) == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert f"{address} is in use" in err


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--speed", "0"], "must be more than 0"),
        (["--speed", "nan"], "must be more than 0"),
        (["--publish", "tcp://0.0.0.0:9872"], "needs CURVE keys"),
        (["--publish", "nonsense"], "must be tcp://"),
    ],
)
def test_usage_errors(arguments, problem, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["replay", "run.mcap", *arguments])
    assert caught.value.code == 2
    assert problem in capsys.readouterr().err


def test_a_replay_identifies_itself_once_a_second(tmp_path):
    address = f"ipc://{tmp_path}/publish"
    with subscriber(address, b"replay/") as socket:
        assert main(["replay", str(rig_recording.path()), "--speed", "2", "--publish", address]) == 0
        found = heard(socket, 1)
        while socket.poll(0):
            found += heard(socket, 1)
    assert 1 <= len(found) <= 4  # the run has 3 s
    for heard_frames in found:
        assert plotjuggler.problems(heard_frames) == []
        fields = msgpack.unpackb(heard_frames[1])
        assert validate(REPLAY, fields) == []
        assert (heard_frames[0], fields["path"], fields["speed"]) == (b"replay/run", rig_recording.path().name, 2.0)


def test_a_loop_runs_until_ctrl_c(tmp_path):
    file, _ = recorded.begun(tmp_path)
    file.finish()
    address = f"ipc://{tmp_path}/publish"
    command = [sys.executable, "-P", "-m", "palmd", "replay", str(file.path), "--loop", "--speed", "9", "--publish"]
    with subscriber(address) as socket, subprocess.Popen([*command, address], stderr=subprocess.PIPE) as process:
        watchdog = threading.Timer(60.0, process.kill)
        watchdog.start()
        found = heard(socket, 3 * 12)
        process.send_signal(signal.SIGINT)
        assert process.stderr.read() == b""
        assert process.wait() == 0
        watchdog.cancel()
    rounds = [found[i : i + 12] for i in (0, 12, 24)]
    assert rounds[0] == rounds[1] == rounds[2]
