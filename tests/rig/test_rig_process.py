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
from harness import Client, Process

from palmd.bus.subscriber import Subscriber
from palmd.config.arms import AdeptConfig
from palmd.devices.actuator import make_actuator
from palmd.devices.versapad import PACKET_BYTES, VersaPadDecoder

pytestmark = pytest.mark.rig


@pytest.fixture
def rig(tmp_path):
    """Starts the rig; it must end without error and print only its JSON line."""

    @contextlib.contextmanager
    def start(*arguments):
        folder = tmp_path / "process"
        folder.mkdir()
        process = Process(["rig", *arguments], folder)
        try:
            yield process, json.loads(process.first_line())
            assert process.end() == 0
            assert (process.error_output(), len(process.lines())) == ("", 1)
        finally:
            process.stop()

    return start


def hear(port, seconds):
    deadline, data = time.monotonic() + seconds, b""
    while time.monotonic() < deadline:
        select.select([port.fileno()], [], [], 0.05)
        data += port.read(4096)
    return data


def test_the_ports_folder_is_created(rig, tmp_path):
    folder = tmp_path / "new" / "ports"
    with rig("--ports", str(folder)) as (_, found):
        assert found["pad1"] == str(folder / "pad1")
        assert {path.name for path in folder.iterdir()} == {"pad1", "pad2", "arm"}
    assert list(folder.iterdir()) == []


def test_ports_speak_the_protocols_and_truth_is_published(rig):
    with rig("--seed", "5") as (_, found), Subscriber(found["truth"], topics=("rig/",)) as truth:
        assert found["seed"] == 5
        with serial.Serial(found["pad1"], 9600, timeout=0, exclusive=True) as pad:
            decoder = VersaPadDecoder(9600)
            packets = decoder.feed(hear(pad, 0.6), 1.0)
            assert len(packets) > 20
            # the port may be opened in the middle of a packet
            assert decoder.counters.bad_data + decoder.counters.bad_header < PACKET_BYTES
            assert all(packet.in_use and packet.pressure > 0 for packet in packets)
        with serial.Serial(found["arm"], 38400, timeout=0, exclusive=True) as arm:
            host = make_actuator(AdeptConfig(port="arm"))
            deadline = time.monotonic() + 5.0
            while host.state is None and time.monotonic() < deadline:
                arm.write(host.poll(time.monotonic(), None).data)
                select.select([arm.fileno()], [], [], 0.01)
                host.feed(arm.read(4096), time.monotonic())
            assert host.state == "R"
            assert host.hello.cycle_s == 0.016
        seen, deadline = {}, time.monotonic() + 20.0
        while set(seen) != {b"rig/truth", b"rig/object"}:
            assert time.monotonic() < deadline, f"only {set(seen)} came"
            for topic, payload, stamp in truth.frames(1, 1.0):
                seen[topic] = msgpack.unpackb(payload)
                assert float(stamp) == pytest.approx(seen[topic]["timestamp"], abs=1e-5)
        assert seen[b"rig/truth"]["contact1"] is True
        assert abs(seen[b"rig/truth"]["mono_ns"] * 1e-9 - time.monotonic()) < 5.0
        assert len(seen[b"rig/object"]["h_m"]) == 360


def test_a_paused_rig_publishes_the_duration(rig):
    with rig("--seed", "5") as (process, found), Subscriber(found["truth"], topics=("rig/",)) as truth:
        assert list(truth.frames(1, 5.0))
        process.send(signal.SIGSTOP)
        time.sleep(0.15)
        process.send(signal.SIGCONT)
        stalls, deadline = [], time.monotonic() + 20.0
        while not stalls or stalls[-1]["lasted_s"] < 0.1:  # a busy machine may have paused it too
            assert time.monotonic() < deadline, f"the pause is not reported; stalls: {stalls}"
            stalls += [msgpack.unpackb(payload) for topic, payload, _ in truth.frames(1, 1.0) if topic == b"rig/stall"]
        assert stalls[-1]["count"] == len(stalls)
        assert abs(stalls[-1]["t_s"] - time.monotonic()) < 5.0


def test_the_control_socket_injects_faults_and_rejects_invalid_requests(rig):
    with rig("--seed", "5", "--kind", "nominal") as (_, found), Client(found["control"]) as client:
        assert client.do("status")["kind"] == "nominal"
        client.do("inject", name="mute", port="pad1", for_s=60.0)
        assert client.do("status")["injected_faults"] == ["mute@pad1"]
        client.do("clear", name="mute")
        for cmd, args in (("inject", {"name": "nonsense"}), ("inject", {"often": 1}), ("dance", {}), ("clear", {})):
            refused = client.ask(cmd, **args)
            assert not refused["ok"]
            assert refused["error"]
        for junk in (b"", b"\xc1", b"\x93\x01\x02\x03", os.urandom(200), msgpack.packb({"cmd": [1]})):
            client.socket.send(junk)
            assert not client.reply()["ok"]
        assert "estop" in client.do("faults")
        client.do("mischief", name="mute", port="pad1", for_s=60.0)  # former names, until 2.0
        status = client.do("status")
        assert status["mischief"] == status["injected_faults"] == ["mute@pad1"]
        client.do("calm", name="mute")
        assert client.do("tricks") == client.do("faults")
        client.do("new_object")
        assert client.do("status")["object"] == 2


def test_unplugging_moves_the_port(rig):
    with rig("--inject", "unplug@pad2,after=0.5,for=0.5") as (_, found):
        before = Path(found["pad2"]).resolve()
        with serial.Serial(found["pad2"], 9600, timeout=0) as pad, pytest.raises((OSError, serial.SerialException)):
            hear(pad, 5.0)
        deadline = time.monotonic() + 5.0
        while not Path(found["pad2"]).exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        assert before.parent == Path(found["pad2"]).resolve().parent
        with serial.Serial(found["pad2"], 9600, timeout=0) as pad:
            assert VersaPadDecoder(9600).feed(hear(pad, 0.4), 1.0)


def test_a_configuration_is_applied(rig, tmp_path):
    config = tmp_path / "palmd.yaml"
    config.write_text(
        "pads:\n  palm1: {port: a, baud: 19200}\n  palm2: {port: b}\narm: {port: c}\n"
        "limits: {phi1_deg: [60, 120], phi2_deg: [50, 110]}\n"
    )
    with rig(str(config)) as (_, found), Client(found["control"]) as client:
        with serial.Serial(found["pad1"], 19200, timeout=0) as pad:
            assert VersaPadDecoder(19200).feed(hear(pad, 0.4), 1.0)
        with serial.Serial(found["pad1"], 9600, timeout=0) as pad:
            decoder = VersaPadDecoder(9600)
            decoder.feed(hear(pad, 0.4), 1.0)
            assert decoder.counters.discarded > 20
        assert client.do("status")["pad1_bytes_sent"] > 50


def test_it_ends_with_its_parent_and_leaves_nothing_behind():
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import subprocess, sys\n"
            "child = subprocess.Popen([sys.executable, '-m', 'palmd', 'rig'], stdout=subprocess.PIPE)\n"
            "print(child.pid, child.stdout.readline().decode(), flush=True)\n"
            "sys.stdin.read()\n",
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    pid, line = parent.stdout.readline().split(maxsplit=1)
    found = json.loads(line)
    assert Path(found["arm"]).exists()
    parent.kill()
    parent.communicate()
    deadline = time.monotonic() + 10.0
    while Path(found["arm"]).parent.exists():
        if time.monotonic() > deadline:
            os.kill(int(pid), signal.SIGKILL)
            pytest.fail("the rig still runs ten seconds after its parent")
        time.sleep(0.02)
