"""The example subscriber in docs/, run as a program of its own."""

import re
import subprocess
import sys
import threading
from pathlib import Path

import rig_recording
import zmq

from palmd.record.player import frames

PROGRAM = Path(__file__).parents[3] / "docs/operate/subscriber.py"
LINE = re.compile(r"r1 ([\d.]+) ± [\d.]+ mm, r2 ([\d.]+) ± [\d.]+ mm, psi (-?[\d.]+) ± [\d.]+°, touched (\d+)%")


def test_the_example_prints_published_messages(tmp_path):
    address = f"ipc://{tmp_path}/publish"
    estimates = [fields for topic, fields in rig_recording.published() if topic == "palm/estimate"]
    unknown, known = estimates[0], [fields for fields in estimates if fields["valid"]][-1]
    assert not unknown["valid"]
    with zmq.Context() as context, context.socket(zmq.XPUB) as socket:
        socket.linger = 0
        socket.bind(address)
        command = [sys.executable, str(PROGRAM), address]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, encoding="utf-8") as process:
            watchdog = threading.Timer(60.0, process.kill)
            watchdog.start()
            assert socket.recv() == b"\x01palm/estimate"  # its only subscription
            for fields in (unknown | {"seq": 0}, known | {"seq": 99}, known | {"seq": 100}):
                socket.send_multipart(frames(rig_recording.raw("palm/estimate", fields)))
            lines = [process.stdout.readline() for _ in range(2)]
            process.kill()
            watchdog.cancel()
    assert lines[0] == "no valid estimate yet\n"
    r1, r2, psi, touched = map(float, LINE.fullmatch(lines[1].rstrip("\n")).groups())
    assert abs(r1 - known["r1_m"] * 1e3) <= 0.005
    assert abs(r2 - known["r2_m"] * 1e3) <= 0.005
    assert abs(psi - known["psi_rad"] * 57.29578) <= 0.051
    assert abs(touched - known["touched"] * 100) <= 0.51
