"""`palmd top`: what a frame shows, how it is painted, and that the terminal is restored."""

import contextlib
import fcntl
import math
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import time

import numpy as np
import pytest
from bus_daemon import bus_daemon

from palmd.bus.subscriber import Message
from palmd.cli import main
from palmd.cli.board import Board, BoardRow, fitted, frame
from palmd.cli.top import painted
from palmd.events import Estimate, PalmMotion
from palmd.faults import TABLE
from palmd.messages import (
    LogEntry,
    PadView,
    contact_fields,
    estimate_fields,
    info_fields,
    log_fields,
    motion_fields,
    rig_fields,
    state_fields,
)
from palmd.quantities import CONTACT, ESTIMATE, INFO, LOG, LOOP, MOTION, RIG, STATE
from palmd.rig.world import default_config
from palmd.system.rig_constants import RIG_NAMES

ZEROS = np.zeros(len(RIG_NAMES))


def estimate(**changes):
    values = dict.fromkeys(Estimate.__dataclass_fields__, math.nan)
    values |= {"t": 1.0, "valid": True, "observer": "shape", "object_count": 2, "touched": 0.34, "r1": 0.02103}
    values |= {"sd": {"r1": 1.2e-5}, "nis": 0.98}
    return estimate_fields(Estimate(**values | changes))


MESSAGES = {
    ESTIMATE: estimate(),
    STATE: state_fields("hold", [TABLE["pad1-lifted"], TABLE["no-realtime"]]),
    CONTACT: contact_fields((PadView(0.021, 45, 0.006, True), PadView(age=3.0, batch=True)), 0.011),
    MOTION: motion_fields(PalmMotion.at_rest((0.5, 1.5)), PalmMotion.at_rest((0.49, 1.51)), "rock", 1, 0.34, "T"),
    LOOP: {"ticks": 1234, "overruns": 2, "lateness_p50_ms": 0.05, "work_p99_ms": 1.5, "rss_mb": 80.2, "backend": "c",
           "pad1_bytes": 9000, "pad1_bad_header": 3, "pad1_port_losses": 1, "pad2_bytes": 8000, "pad2_bad_header": 0},
    INFO: info_fields("0.1.0", "shape", default_config()),
}  # fmt: skip


def board(*topics, t=100.0):
    shown = Board("tcp://127.0.0.1:9872")
    for topic in topics or MESSAGES:
        shown.take(Message(topic.name, MESSAGES[topic], t))
    return shown


def text(rows):
    return "\n".join(row.text for row in rows)


def test_a_frame_shows_every_quantity():
    shown_text = text(frame(board(), 100.1))
    assert "palmd 0.1.0  HOLD  tcp://127.0.0.1:9872" in shown_text
    assert "valid, shape, object 2, touched 34 %, nis 0.98, obs –" in shown_text
    assert "r1    21.03 ±0.01 mm" in shown_text
    assert "r2        – ±– mm" in shown_text
    assert "pad 1  touched     21.00 mm  pressure  45  age    6 ms" in shown_text
    assert "pad 2  untouched       – mm  pressure   –  age 3000 ms, batched" in shown_text
    assert "phi1   28.07° commanded   28.65°   phi2   86.52° commanded   85.94°" in shown_text
    assert "arm    T   plan rock, segment 1, 34 %" in shown_text
    assert "ticks 1234, overruns 2, c backend, 80 MB" in shown_text
    assert "pad1      bad_header 3, losses 1" in shown_text
    assert "9000" not in shown_text
    assert " s old" not in shown_text


def test_faults_come_with_their_hints_and_gravity():
    rows = frame(board(), 100.1)
    (hold,) = [row for row in rows if "pad1-lifted" in row.text]
    assert hold == BoardRow(f"  hold    pad1-lifted: {TABLE['pad1-lifted'].hint}", "bad")
    (note,) = [row for row in rows if "no-realtime" in row.text]
    assert note.style == "faint"


def test_mis_calibrated_constants_are_listed_below_the_faults():
    shown = board()
    before = len(frame(shown, 100.1))
    off = rig_fields(np.array([3e-4, *ZEROS[1:]]), ZEROS + 3e-5, ZEROS + 1e-4, ZEROS)
    shown.take(Message(RIG.name, off, 100.0))
    rows = frame(shown, 100.1)
    assert len(rows) == before + 2  # and one more of the topics
    (row,) = [row for row in rows if row.text.startswith("  rig     ")]
    assert row == BoardRow(
        "  rig     pad 1's zero seems +0.30 ± 0.03 mm off: palmd calibrate self finds its zero_mm", "warning"
    )


def test_old_data_are_marked_as_old():
    shown = board()
    shown.take(Message(LOOP.name, MESSAGES[LOOP], 101.5))
    shown_text = text(frame(shown, 102.0))
    assert shown_text.count("2.0 s old") == 3  # the frequent topics
    assert "no data" not in shown_text
    assert "no data from tcp://127.0.0.1:9872 for 9 s; the following data are old" in text(frame(shown, 110.5))


def test_the_latest_log_entry_comes_first_with_its_age():
    entries = [LogEntry(i, 90.0 + i, "fault", "arm-late", "degrade", "", math.nan, f"cause {i}") for i in range(9)]
    shown = board()
    shown.take(Message(LOG.name, log_fields(entries) | {"mono_ns": 100_000_000_000}, 100.0))
    shown_text = [row for row in frame(shown, 102.0) if "cause" in row.text]
    assert shown_text[0].text.split() == ["log", "4.0", "s", "ago", "arm-late:", "cause", "8"]
    assert shown_text[0].style == "warning"
    assert len(shown_text) == 4


def test_without_data_it_shows_the_address():
    shown_text = text(frame(Board("tcp://127.0.0.1:1"), 5.0))
    assert shown_text == "no data from tcp://127.0.0.1:1: check that palmd runs there"


@pytest.mark.parametrize("topic", MESSAGES)
def test_a_frame_is_drawn_from_any_single_topic_even_if_empty(topic):
    assert frame(board(topic), 100.0)
    empty = Board("x")
    empty.take(Message(topic.name, {}, 100.0))
    assert frame(empty, 100.0)


def test_everything_fits_on_80_by_24():
    """Two faults, one mis-calibrated constant, errors on a port, every topic with rate and age: nothing is cut."""
    shown = Board("tcp://127.0.0.1:9872")
    off = rig_fields(np.array([3e-4, *ZEROS[1:]]), ZEROS + 3e-5, ZEROS + 1e-4, ZEROS)
    for tick in range(200):
        for topic, fields in MESSAGES.items():
            if topic.rate_hz > 50 or tick % 100 == 0:
                shown.take(Message(topic.name, fields, 100.0 + tick * 0.01))
    shown.take(Message(RIG.name, off, 102.0))
    rows = frame(shown, 102.1)
    seen = fitted(rows, 80, 24)
    assert len(seen) <= 24
    assert max(len(row.text) for row in seen) <= 80
    words = " ".join(" ".join(row.text for row in seen).split())
    for row in rows:
        assert " ".join(row.text.split()) in words
    assert "contact 100/s 110 ms" in words
    assert "info 1/s 1 s" in words
    assert "rig –/s 100 ms" in words


def test_painting_fits_the_terminal():
    rows = [BoardRow("a" * 50, "bad"), BoardRow(""), BoardRow("second"), BoardRow("minor", "faint"), BoardRow("third")]
    drawn = painted(rows, columns=10, lines=3)
    assert drawn.startswith("\x1b[H\x1b[31;1m" + "a" * 10 + "\x1b[m\x1b[K\n")
    assert drawn.endswith("third\x1b[m\x1b[K\x1b[J")
    assert "minor" not in drawn
    (first, last) = fitted(rows, columns=80, lines=2)
    assert (first.style, last.text) == ("bad", "... 2 more lines: make the terminal higher")
    long = BoardRow("  hold    pad1-lifted: put the object back, then start goes on")
    assert [row.text for row in fitted([long], 40, 5)] == [
        "  hold    pad1-lifted: put the object",
        "          back, then start goes on",
    ]


# ------------------------------------------------------------------------------------------------ the command


@pytest.fixture
def daemon(tmp_path):
    """The address where a daemon publishes every topic repeatedly."""

    def publish(bus):
        for topic, fields in MESSAGES.items():
            bus.publish(topic, dict(fields), time.monotonic(), time.time())

    with bus_daemon(tmp_path, lambda _: None, publish) as (address, _):
        yield address


def test_once_prints_one_plain_frame(daemon, capsys):
    assert main(["top", "--once", "--address", daemon]) == 0
    out = capsys.readouterr().out
    assert "HOLD" in out
    assert "ticks 1234" in out
    assert "\x1b" not in out


def test_once_without_data_ends_with_3(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("palmd.cli.top.TIMEOUT_S", 0.05)
    address = f"ipc://{tmp_path}/nobody"
    assert main(["top", "--once", "--address", address]) == 3
    assert (
        capsys.readouterr().err
        == f"no data from {address}: is a palmd running there, and may this user open its socket"
        " (its group, mostly palmd), does it have keys (then give --key)?\n"
    )


def command(address):
    return [sys.executable, "-m", "palmd", "top", "--address", address]


def test_in_a_pipe_it_prints_plain_frames_until_interrupted(daemon):
    with subprocess.Popen(command(daemon), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert "HOLD" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=10)
    assert "\x1b" not in out
    assert err == ""
    assert process.returncode == 130


@pytest.mark.parametrize("end", ["q", "SIGTERM", "SIGINT"])
def test_on_a_terminal_it_redraws_resizes_and_restores_the_terminal(daemon, end):
    main_end, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    before = termios.tcgetattr(terminal)
    with subprocess.Popen(command(daemon), stdin=terminal, stdout=terminal, stderr=terminal) as process:
        try:
            screen = shown(main_end, lambda screen: screen.count(b"HOLD") > 2)
            assert screen.startswith(b"\x1b[?1049h\x1b[?25l\x1b[H")
            fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 3, 20, 0, 0))
            shown(main_end, lambda screen: screen.count(b"HOLD") > 4 and b"ticks" not in screen[-200:])
            if end == "q":
                os.write(main_end, b"q")
            else:
                process.send_signal(getattr(signal, end))
            rest = shown(main_end, lambda screen: screen.endswith(b"\x1b[?25h\x1b[?1049l"))
            assert process.wait(10) == 0
            assert b"Traceback" not in rest
            assert termios.tcgetattr(terminal) == before
        finally:
            process.kill()
    os.close(main_end)
    os.close(terminal)


def shown(descriptor, enough):
    """Reads what a terminal is sent until `enough`."""
    screen = b""
    deadline = time.monotonic() + 10.0
    while not enough(screen):
        assert time.monotonic() < deadline, screen
        if select.select([descriptor], [], [], 0.1)[0]:
            with contextlib.suppress(OSError):
                screen += os.read(descriptor, 65536)
    return screen
