"""`palmd jog`: the palms turn while a key is held, and only then."""

import contextlib
import itertools
import math
import os
import pty
import threading
import time

import pytest
from bus_daemon import bus_daemon

from palmd.bus.jogging import JOG_EVERY_S as EVERY_S
from palmd.bus.jogging import JOG_STEP_DEG as STEP_DEG
from palmd.cli import jog, main
from palmd.cli.jog import HELD_S, DeadMansSwitch, line
from palmd.config.two_palms import LimitsConfig
from palmd.daemon.commands import JOG_STEP_MAX_DEG, Reply
from palmd.daemon.jog import DEAD_MAN_S, RATE
from palmd.quantities import MOTION

RIGHT, LEFT, UP, DOWN = b"\x1b[C", b"\x1b[D", b"\x1b[A", b"\x1b[B"


@pytest.mark.parametrize(("key", "phi1", "phi2"), [(RIGHT, 1, 0), (LEFT, -1, 0), (UP, 0, 1), (DOWN, 0, -1),
                                                   (b"\x1bOC", 1, 0)])  # fmt: skip
def test_arrows(key, phi1, phi2):
    handle = DeadMansSwitch()
    assert handle.pressed(key, 1.0) == []
    assert handle.step(1.0) == {"phi1_deg": STEP_DEG * phi1, "phi2_deg": STEP_DEG * phi2}


def test_releasing_the_key_stops_the_jog():
    handle = DeadMansSwitch()
    assert handle.step(0.0) is None
    handle.pressed(RIGHT * 3, 1.0)
    assert handle.step(1.0 + HELD_S - 1e-3) is not None
    assert handle.step(1.0 + HELD_S + 1e-3) is None


def test_the_last_arrow_counts_and_any_other_key_stops():
    handle = DeadMansSwitch()
    handle.pressed(RIGHT + UP, 1.0)
    assert handle.step(1.0) == {"phi1_deg": 0.0, "phi2_deg": STEP_DEG}
    handle.pressed(b"x", 1.01)
    assert handle.step(1.01) is None


def test_keys_for_other_commands():
    assert DeadMansSwitch().pressed(b"aS" + RIGHT + b"q", 0.0) == ["arm", "stop", "end"]
    assert DeadMansSwitch().pressed(b"\x03", 0.0) == ["end"]


def test_the_daemon_accepts_the_steps_and_the_motion_is_continuous():
    assert JOG_STEP_MAX_DEG >= STEP_DEG
    assert math.degrees(RATE) >= STEP_DEG / EVERY_S
    assert 2.0 * EVERY_S < DEAD_MAN_S
    assert HELD_S > 2.0 / 20.0  # slow terminals repeat 20 times a second


def test_the_line_shows_angles_limits_and_faults():
    motion, state = {"phi1_rad": 0.5, "phi2_rad": 1.5}, {"state": "hold", "faults": ["pad1-lifted"]}
    text = line(motion, state, LimitsConfig(), "", 100)
    assert text == "phi1  28.6° (6 to 150)  phi2  85.9° (35 to 155)  hold  pad1-lifted"


REFUSED = "jog refused: phi1 reaches 150.4°, the limit is 150°"


def test_the_status_is_one_line_with_refusals_first_and_without_nan():
    motion, state = {"phi1_rad": 0.5, "phi2_rad": 1.5}, {"state": "tracking", "faults": ["pad1-lifted", "pad2-lifted"]}
    text = line(motion, state, LimitsConfig(), REFUSED, 80)
    assert text.startswith("phi1  28.6°  phi2  85.9°  tracking  jog refused: phi1 reaches 150.4°, the lim")
    assert len(text) < 80
    assert text.endswith("…")
    for columns in (0, 1, 2, 20, 79):
        assert len(line(motion, state, LimitsConfig(), REFUSED, columns)) <= max(columns - 1, 1)
    nothing = line({}, {}, LimitsConfig(), "", 80)
    assert "nan" not in nothing
    assert nothing.startswith("phi1     –° (6 to 150)  phi2     –° (35 to 155)")
    nan = line({"phi1_rad": math.nan, "phi2_rad": math.nan}, {}, LimitsConfig(), "", 80)
    assert nan == nothing


@contextlib.contextmanager
def daemon(folder, refusing=()):
    """A daemon's bus that publishes a motion and grants all commands but the given ones; collects the commands."""
    asked = []

    def answer(request):
        asked.append((request.name, request.args, time.monotonic()))
        return Reply(request, "not now" if request.name in refusing else None, {})

    def motion(bus):
        bus.publish(MOTION, {"phi1_rad": 0.5, "phi2_rad": 1.5}, time.monotonic(), time.time())

    with bus_daemon(folder, answer, motion):
        yield asked


@contextlib.contextmanager
def terminal(monkeypatch):
    """Standard input and output on a pseudo-terminal; its far end."""
    master, slave = pty.openpty()
    os.set_blocking(master, False)
    with os.fdopen(slave, "r+b", buffering=0) as end, open(slave, "w", closefd=False) as out:
        monkeypatch.setattr(jog.sys, "stdin", end)
        monkeypatch.setattr(jog.sys, "stdout", out)
        yield master
    os.close(master)


def at_the_keys(master, presses):
    """Presses each key for a given time."""

    def press():
        _until_ready(master)
        for key, seconds in presses:
            t_end = time.monotonic() + seconds
            while time.monotonic() < t_end:
                if key:
                    os.write(master, key)
                with contextlib.suppress(BlockingIOError):
                    os.read(master, 4096)
                time.sleep(0.03)
        os.write(master, b"q")

    thread = threading.Thread(target=press)
    thread.start()
    return thread


def _until_ready(master):
    """Waits for the help line and the first status line: from then on keys are read at once."""
    said, deadline = b"", time.monotonic() + 20.0
    while b"phi1" not in said and time.monotonic() < deadline:
        with contextlib.suppress(BlockingIOError):
            said += os.read(master, 4096)
        time.sleep(0.01)


def sitting(tmp_path, monkeypatch, presses, **options):
    path = tmp_path / "palmd.yaml"
    path.write_text(
        "pads: {palm1: {port: a}, palm2: {port: b}}\narm: {port: c}\n"
        f'bus: {{publish: "ipc://{tmp_path}/publish", command: "ipc://{tmp_path}/command"}}\n'
    )
    with daemon(tmp_path, **options) as asked, terminal(monkeypatch) as master:
        thread = at_the_keys(master, presses)
        assert main(["jog", str(path)]) == 0
        thread.join()
    return asked


def test_a_jog_session(tmp_path, monkeypatch):
    """Armed, turned while the key is held, at rest otherwise; finally stopped, because the command has armed it."""
    asked = sitting(tmp_path, monkeypatch, [(b"a", 0.02), (RIGHT, 0.5), (b"", 0.5), (DOWN, 0.3)])
    names = [name for name, _, _ in asked]
    assert names[:2] == ["status", "arm"]
    assert names[-1] == "stop"
    steps = [(args["phi1_deg"], args["phi2_deg"], t) for name, args, t in asked if name == "jog"]
    assert {step[:2] for step in steps} == {(STEP_DEG, 0.0), (0.0, -STEP_DEG)}
    gaps = [later[2] - sooner[2] for sooner, later in itertools.pairwise(steps)]
    assert max(gaps) > 0.3


def test_an_arm_that_was_armed_before_is_not_stopped(tmp_path, monkeypatch):
    asked = sitting(tmp_path, monkeypatch, [(b"a", 0.02), (RIGHT, 0.2)], refusing=("arm", "jog"))
    assert [name for name, _, _ in asked if name == "stop"] == []
