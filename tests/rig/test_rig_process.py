"""`palmd rig` as a process: its JSON line, its ports and sockets, its end."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgpack
import pytest
import serial
import zmq

from palmd.config.arms import AdeptConfig
from palmd.devices.actuator import make_actuator
from palmd.devices.versapad import VersaPadDecoder

pytestmark = pytest.mark.rig

PROGRAM = """
import argparse, sys
from palmd.rig.app import add_arguments, run_rig
parser = argparse.ArgumentParser()
add_arguments(parser)
sys.exit(run_rig(parser.parse_args()))
"""


@contextlib.contextmanager
def rig(*arguments):
    """The running process and what its JSON line says; it must end cleanly and say nothing else."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert select.select([process.stdout], [], [], 20.0)[0], "no JSON line"
        yield process, json.loads(process.stdout.readline())
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=10.0)
        assert (process.returncode, out, err) == (0, "", "")
    finally:
        process.kill()
        process.communicate()


@contextlib.contextmanager
def control(found):
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.linger = 0
        socket.rcvtimeo = 5000
        socket.connect(found["control"])

        def ask(cmd, **args):
            socket.send(msgpack.packb({"id": 7, "cmd": cmd, "args": args}))
            return msgpack.unpackb(socket.recv())

        yield ask, socket


def hear(port, seconds):
    deadline, data = time.monotonic() + seconds, b""
    while time.monotonic() < deadline:
        select.select([port.fileno()], [], [], 0.05)
        data += port.read(4096)
    return data


def test_the_ports_folder_is_made(tmp_path):
    folder = tmp_path / "new" / "ports"
    with rig("--ports", str(folder)) as (_, found):
        assert found["pad1"] == str(folder / "pad1")
        assert {path.name for path in folder.iterdir()} == {"pad1", "pad2", "arm"}
    assert list(folder.iterdir()) == []


def test_a_ports_folder_that_cannot_be_is_told_in_one_line(tmp_path):
    (tmp_path / "file").touch()
    for folder, complaint in (("file", "is not a folder"), ("file/new", "Not a directory"), ("x" * 300, "too long")):
        command = [sys.executable, "-c", PROGRAM, "--ports", str(tmp_path / folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.startswith(f"--ports: {tmp_path / folder}")
        assert complaint in done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_ports_speak_the_protocols_and_truth_is_published():
    with rig("--seed", "5") as (_, found), zmq.Context() as context, context.socket(zmq.SUB) as truth:
        assert found["seed"] == 5
        truth.linger = 0
        truth.rcvtimeo = 5000
        truth.connect(found["truth"])
        truth.subscribe(b"rig/")
        with serial.Serial(found["pad1"], 9600, timeout=0, exclusive=True) as pad:
            decoder = VersaPadDecoder(9600)
            packets = decoder.feed(hear(pad, 0.6), 1.0)
            assert len(packets) > 20
            assert decoder.counters.bad_data + decoder.counters.bad_header == 0
            assert all(packet.in_use and packet.pressure > 0 for packet in packets)
        with serial.Serial(found["arm"], 38400, timeout=0, exclusive=True) as arm:
            host = make_actuator(AdeptConfig(port="arm"))
            deadline = time.monotonic() + 5.0
            while host.state is None and time.monotonic() < deadline:
                arm.write(host.poll(time.monotonic(), None).data)
                select.select([arm.fileno()], [], [], 0.01)
                host.feed(arm.read(4096), time.monotonic())
            assert host.state == "R"
            assert host.hello is not None
            assert host.hello.cycle_s == 0.016
        seen, deadline = {}, time.monotonic() + 20.0
        while set(seen) != {b"rig/truth", b"rig/object"}:
            assert time.monotonic() < deadline, f"only {set(seen)} came"
            topic, payload, stamp = truth.recv_multipart()
            seen[topic] = msgpack.unpackb(payload)
            assert float(stamp) == pytest.approx(seen[topic]["timestamp"], abs=1e-5)
        assert seen[b"rig/truth"]["contact1"] is True
        assert abs(seen[b"rig/truth"]["mono_ns"] * 1e-9 - time.monotonic()) < 5.0
        assert len(seen[b"rig/object"]["h_m"]) == 360


def test_a_rig_that_was_stopped_says_for_how_long():
    with rig("--seed", "5") as (process, found), zmq.Context() as context, context.socket(zmq.SUB) as truth:
        truth.linger = 0
        truth.rcvtimeo = 5000
        truth.connect(found["truth"])
        truth.subscribe(b"rig/")
        truth.recv_multipart()
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.15)
        process.send_signal(signal.SIGCONT)
        told, deadline = [], time.monotonic() + 20.0
        while not told or told[-1]["lasted_s"] < 0.1:  # a busy machine may have had it wait besides
            assert time.monotonic() < deadline, f"no word of the pause; stalls: {told}"
            topic, payload, _ = truth.recv_multipart()
            told += [msgpack.unpackb(payload)] if topic == b"rig/stall" else []
        assert told[-1]["count"] == len(told)
        assert abs(told[-1]["t_s"] - time.monotonic()) < 5.0


def test_control_switches_mischief_and_survives_strangers():
    with rig("--seed", "5", "--kind", "nominal") as (_, found), control(found) as (ask, socket):
        answer = ask("status")
        assert answer["ok"]
        assert answer["id"] == 7
        assert answer["result"]["kind"] == "nominal"
        assert ask("mischief", name="mute", port="pad1", for_s=60.0)["ok"]
        assert ask("status")["result"]["mischief"] == ["mute@pad1"]
        assert ask("calm", name="mute")["ok"]
        for cmd, args in (
            ("mischief", {"name": "nonsense"}),
            ("mischief", {"often": 1}),
            ("dance", {}),
            ("calm", {}),
        ):
            refused = ask(cmd, **args)
            assert not refused["ok"]
            assert refused["error"]
        for junk in (b"", b"\xc1", b"\x93\x01\x02\x03", os.urandom(200), msgpack.packb({"cmd": [1]})):
            socket.send(junk)
            assert not msgpack.unpackb(socket.recv())["ok"]
        assert "estop" in ask("tricks")["result"]
        assert ask("new_object")["ok"]
        assert ask("status")["result"]["object"] == 2


def test_unplugging_moves_the_port():
    with rig("--mischief", "unplug@pad2,after=0.5,for=0.5") as (_, found):
        before = Path(found["pad2"]).resolve()
        with (
            serial.Serial(found["pad2"], 9600, timeout=0) as pad,
            pytest.raises((OSError, serial.SerialException)),
        ):
            hear(pad, 5.0)
        deadline = time.monotonic() + 5.0
        while not Path(found["pad2"]).exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        assert before.parent == Path(found["pad2"]).resolve().parent
        with serial.Serial(found["pad2"], 9600, timeout=0) as pad:
            assert VersaPadDecoder(9600).feed(hear(pad, 0.4), 1.0)


def test_a_configuration_is_obeyed(tmp_path):
    config = tmp_path / "palmd.yaml"
    config.write_text(
        "pads:\n  palm1: {port: a, baud: 19200}\n  palm2: {port: b}\narm: {port: c}\n"
        "limits: {phi1_deg: [60, 120], phi2_deg: [50, 110]}\n"
    )
    with rig(str(config)) as (_, found), control(found) as (ask, _):
        with serial.Serial(found["pad1"], 19200, timeout=0) as pad:
            assert VersaPadDecoder(19200).feed(hear(pad, 0.4), 1.0)
        with serial.Serial(found["pad1"], 9600, timeout=0) as pad:
            decoder = VersaPadDecoder(9600)
            decoder.feed(hear(pad, 0.4), 1.0)
            assert decoder.counters.discarded > 20
        assert ask("status")["result"]["pad1_bytes_sent"] > 50


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["nowhere.yaml"], "nowhere.yaml"),
        (["--mischief", "nonsense"], "unknown fault 'nonsense'"),
        (["--seed", "-1"], "--seed"),
        (["CONFIG"], "hinge: arc"),
    ],
)
def test_bad_input_is_one_clear_line(tmp_path, arguments, text):
    config = tmp_path / "palmd.yaml"
    config.write_text("rig: {hinge: fixed}\npads: {palm1: {port: a}, palm2: {port: b}}\narm: {port: c}\n")
    arguments = [str(config) if argument == "CONFIG" else argument for argument in arguments]
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments], capture_output=True, text=True, timeout=30, check=False
    )
    assert done.returncode == 1
    assert done.stdout == ""
    assert text in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_it_ends_with_its_parent_and_leaves_nothing_behind():
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import subprocess, sys\n"
            f"child = subprocess.Popen([sys.executable, '-c', {PROGRAM!r}], stdout=subprocess.PIPE)\n"
            "print(child.pid, child.stdout.readline().decode(), flush=True)\n"
            "sys.stdin.read()\n",
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert parent.stdout is not None
    pid, line = parent.stdout.readline().split(maxsplit=1)
    found = json.loads(line)
    assert Path(found["arm"]).exists()
    parent.kill()
    parent.communicate()
    deadline = time.monotonic() + 10.0
    while Path(found["arm"]).parent.exists():
        if time.monotonic() > deadline:
            os.kill(int(pid), signal.SIGKILL)
            pytest.fail("the rig outlived its parent by ten seconds")
        time.sleep(0.02)
