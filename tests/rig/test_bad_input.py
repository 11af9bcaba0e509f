"""Common mistakes: each is reported with a clear message, and none stops what still works."""

import math
import os
import random

import msgpack
import pytest
import serial
from harness import LEAST_WORK, PLAN, Bench, palmd

pytestmark = pytest.mark.rig

FAR = PLAN.replace("phi1_deg: 45", "phi1_deg: 75")
MESSAGES = 1000
SWAPPED_TICKS = 800
UNCHANGED = ("state", "plan", "segment", "progress", "moving", "arm_state")


@pytest.fixture
def start(tmp_path):
    """Starts a bench whose daemon has a wrong configuration."""
    started = []

    def begin(**changes):
        started.append(Bench(tmp_path, **changes))
        return started[-1]

    yield begin
    for each in started:
        each.close()


def test_a_missing_port_is_reported_and_opened_when_it_appears(start, tmp_path):
    port = tmp_path / "not-yet"
    bench = start(pads={"palm1": {"port": str(port)}}, **LEAST_WORK)
    bench.until_faults("pad1-port")
    bench.until(lambda _: bench.motion["arm_state"] == "R", "the connected arm")
    bench.until(lambda heard: heard.latest["palm/contact"]["touch2"], "the connected pad 2")
    assert f"no such port {port}" in bench.daemon.all_said
    assert bench.heard.state == "idle"
    refused = bench.client.ask("arm")
    assert "it must be ready" in refused["error"]
    port.symlink_to(bench.ports["pad1"])
    bench.until_gone("pad1-port")
    bench.run_plan()


def test_a_port_held_by_another_process_is_reported_and_opened_when_released(start):
    bench = start(**LEAST_WORK)
    bench.until_state("ready")
    bench.daemon.end()
    with serial.Serial(str(bench.ports["arm"]), 38400, exclusive=True):
        bench.start_daemon(**LEAST_WORK)
        bench.until_faults("arm-port")
        bench.until(lambda heard: heard.latest["palm/contact"]["touch1"], "pad 1, which is free")
        assert f"{bench.ports['arm']} is held by another process" in bench.daemon.all_said
        assert bench.heard.state == "idle"
    bench.ready()


def test_a_wrong_baud_rate_is_reported_and_nothing_moves(start):
    bench = start(pads={"palm1": {"baud": 19200}}, arm={"baud": 19200})
    bench.until_faults("pad1-garbled", "pad1-untouched", "arm-mute")
    bench.ticks(50)
    assert bench.heard.state == "idle"
    estimate = bench.heard.latest["palm/estimate"]
    assert estimate["valid"] is False
    hints = "".join(bench.heard.latest["palm/state"]["hints"])
    assert "arm.baud" in hints
    assert "check its baud" in hints
    assert bench.rig_status()["starts"] == 0
    bench.judge()


def test_swapped_pads_are_reported(start, tmp_path):
    bench = start(
        pads={"palm1": {"port": str(tmp_path / "ports/pad2")}, "palm2": {"port": str(tmp_path / "ports/pad1")}}
    )
    bench.run_plan()
    bench.until(lambda heard: heard.faults.keys() & {"pads-swapped"} or heard.ticks > SWAPPED_TICKS, "some seconds")
    assert "pads-swapped" in bench.heard.faults
    assert bench.heard.latest["palm/estimate"]["valid"] is False


def test_an_invalid_plan_is_refused_and_changes_nothing(bench):
    path = bench.folder / "bad.yaml"
    path.write_text(FAR)
    bench.run_plan()
    bench.client.do("hold")
    bench.until_state("hold")
    bench.at_rest()
    before, stood = bench.client.do("status"), bench.truth()
    refused = bench.client.ask("plan", path="bad.yaml")
    assert refused["ok"] is False
    assert "bad.yaml:4:" in refused["error"]
    done = palmd("ctl", "plan", path, "--take", "--address", bench.bus.command)
    assert done.returncode == 1
    assert f"{path}:4:" in done.stderr
    after, stands = bench.client.do("status"), bench.truth()
    assert [after[key] for key in UNCHANGED] == [before[key] for key in UNCHANGED]
    assert max(abs(stands[phi] - stood[phi]) for phi in ("phi1_rad", "phi2_rad")) < 1e-3
    bench.client.do("start", take=True)
    bench.moving()
    bench.judge()


def test_a_jog_beyond_the_limits_moves_nothing(bench):
    bench.ready()
    bench.client.do("arm")
    bench.until_state("tracking")
    stood = bench.at_rest()
    done = palmd("ctl", "jog", "--phi1-deg", "90", "--take", "--address", bench.bus.command)
    assert done.returncode == 1
    assert "jog refused: phi1 reaches" in done.stderr
    stands = bench.truth()
    assert max(abs(stands[phi] - stood[phi]) for phi in ("phi1_rad", "phi2_rad")) < 1e-3

    def jogged(_):
        done = palmd("ctl", "jog", "--phi2-deg", "-2", "--take", "--address", bench.bus.command)
        assert done.returncode == 0 or "the arm does not follow yet" in done.stderr, done.stderr
        return done.returncode == 0

    bench.until(jogged, "the arm following again after a delay of a slow machine")
    assert math.degrees(bench.at_rest()["phi2_rad"] - stood["phi2_rad"]) == pytest.approx(-2.0, abs=0.2)
    bench.judge()


def strange_messages(count):
    """Arbitrary bytes, and commands with an error; never a valid one."""
    chance = random.Random(7)
    wrong = [
        {"id": 1, "cmd": "jog", "args": {"phi1_deg": float("nan")}},
        {"id": 1, "cmd": "jog", "args": {"phi1_deg": 1e300}},
        {"id": 1, "cmd": "jog", "args": {"phi1_deg": True}},
        {"id": 1, "cmd": "start", "args": {"now": 1}},
        {"id": 1, "cmd": "stop", "args": [1]},
        {"id": 1, "cmd": "plan", "args": {"path": "a\0b"}},
        {"id": 1, "cmd": ["stop"]},
        {"id": [1], "cmd": "stopp"},
        {"cmd": "reset", "extra": 1},
        {1: 2},
        [],
        None,
    ]
    for number in range(count):
        kind = number % 4
        if kind == 0:
            yield [os.urandom(chance.choice((0, 1, 7, 60, 2000)))]
        elif kind == 1:
            whole = msgpack.packb({"id": number, "cmd": "stop", "args": {}})
            yield [whole[: chance.randrange(len(whole))]]
        elif kind == 2:
            yield [msgpack.packb(chance.choice(wrong))]
        else:
            yield [os.urandom(5) for _ in range(chance.randrange(2, 5))]


def test_invalid_messages_on_the_command_socket_change_nothing(bench):
    bench.run_plan()
    bench.forget()
    before = bench.heard.latest["palm/loop"]
    messages = list(strange_messages(MESSAGES))
    for first in range(0, MESSAGES, 20):
        batch = messages[first : first + 20]
        for frames in batch:
            bench.client.socket.send_multipart(frames)
        for _ in batch:
            reply = bench.client.reply()
            assert reply["ok"] is False
            assert 0 < len(reply["error"]) < 300
        bench.drain()
    with_nobody_listening = bench.stranger.socket
    for frames in messages:
        with_nobody_listening.send_multipart(frames)
    bench.until(lambda heard: heard.latest["palm/loop"]["bus_malformed"] == 2 * MESSAGES, "all messages counted")
    assert bench.client.do("status")["state"] == "tracking" or bench.stalled(), bench.daemon.all_said[-3000:]
    after = bench.heard.latest["palm/loop"]
    assert after["overruns"] - before["overruns"] <= 0.05 * (after["ticks"] - before["ticks"])
    bench.moving()
    bench.judge()
