"""The loop on pseudo-terminals and real sockets: its time grid, its ports, its end."""

import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import msgpack
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st
from waiting import wait

from palmd.config.arms import AdeptConfig
from palmd.config.pads import VersaPadConfig
from palmd.config.two_palms import Config, PadsConfig
from palmd.daemon.bus import Bus
from palmd.daemon.core import Core
from palmd.daemon.loop import Loop, next_deadline
from palmd.daemon.systemd import Notifier
from palmd.devices.armlink import Ack, ArmState, HelloReply, Pose, Query, encode_reply, parse_command
from palmd.devices.port import Port
from palmd.devices.versapad import encode_packet
from palmd.messages import info_fields
from palmd.rig.world import default_config
from palmd.topics import TOPICS
from tools.published import validate
from tools.studies.stub_observers import EmptyObserver

PERIOD = 0.01


@given(st.floats(0.0, 1e5), st.floats(0.0, 1.0))
def test_the_grid_continues_after_now_and_skips_whole_periods(deadline, behind):
    now = deadline + behind
    following, skipped = next_deadline(deadline, now, PERIOD)
    assert now - 1e-9 <= following <= now + PERIOD + 1e-9
    periods = (following - deadline) / PERIOD
    assert periods == pytest.approx(round(periods), abs=1e-4)
    assert skipped == round(periods) - 1


def test_work_shorter_than_a_period_skips_nothing():
    assert next_deadline(5.0, 5.009, PERIOD) == (pytest.approx(5.01), 0)
    assert next_deadline(5.0, 4.999, PERIOD) == (pytest.approx(5.01), 0)
    assert next_deadline(5.0, 5.021, PERIOD) == (pytest.approx(5.03), 2)


class Wires:
    """A loop in a thread, and the far ends of its ports."""

    def __init__(self, folder):
        self.folder = folder
        self.masters = {}
        config = Config(
            pads=PadsConfig(palm1=VersaPadConfig(port="pad1"), palm2=VersaPadConfig(port="pad2")),
            arm=AdeptConfig(port="arm"),
        )
        self.ports = {
            "pad1": Port("pad1", str(folder / "pad1"), 9600, retry_s=0.05),
            "pad2": Port("pad2", str(folder / "pad2"), 9600, retry_s=0.05),
            "arm": Port("arm", str(folder / "arm"), 38400, retry_s=0.05),
        }
        self.observer = EmptyObserver()
        self.aside = ThreadPoolExecutor(1)
        self.bus = Bus(f"ipc://{folder}/p", f"ipc://{folder}/c")
        self.core = Core(config, self.observer, self.aside)
        self.loop = Loop(
            self.core,
            self.ports,
            self.bus,
            Notifier({}),
            rate_hz=1.0 / PERIOD,
            backend="c",
            info=info_fields("0", "deaf", default_config()),
        )
        self.context = zmq.Context()
        self.messages = self.context.socket(zmq.SUB)
        self.messages.subscribe(b"")
        self.messages.connect(f"ipc://{folder}/p")
        self.client = self.context.socket(zmq.REQ)
        self.client.setsockopt(zmq.RCVTIMEO, 20_000)
        self.client.connect(f"ipc://{folder}/c")
        self.rest = None
        self.thread = threading.Thread(target=self._run)
        self.answering = True

    def _run(self):
        self.rest = self.loop.run()

    def plug(self, name):
        master, slave = os.openpty()
        path = self.folder / name
        path.unlink(missing_ok=True)
        path.symlink_to(os.ttyname(slave))
        os.close(slave)
        os.set_blocking(master, False)
        self.masters[name] = master

    def unplug(self, name):
        os.close(self.masters.pop(name))

    def answer(self):
        """The controller, ready and at rest, and two fingers on the pads."""
        pending = b""
        while self.answering:
            time.sleep(0.005)
            for name in ("pad1", "pad2"):
                if name in self.masters:
                    os.write(self.masters[name], encode_packet(0, 0, 20))
            if "arm" not in self.masters:
                continue
            try:
                pending += os.read(self.masters["arm"], 1000)
            except (BlockingIOError, OSError):
                continue
            *lines, pending = pending.split(b"\n")
            for line in lines:
                command = parse_command(line.split(b"*")[0].decode())
                reply = HelloReply(0.016, 0.1, 0.6, -0.4, 0.3, 2.0, 50.0)
                if isinstance(command, Query):
                    reply = Ack(command.ss, ArmState.READY, Pose(0.25, 0.0, 2.358))
                os.write(self.masters["arm"], encode_reply(reply))

    def call(self, cmd):
        self.client.send(msgpack.packb({"id": 1, "cmd": cmd}))
        return msgpack.unpackb(self.client.recv())

    def wait_for(self, state, seconds=20.0):
        t_end = time.monotonic() + seconds
        while (found := self.call("status")["result"]["state"]) != state:
            assert time.monotonic() < t_end, found
        return found

    def heard(self):
        while self.messages.poll(0):
            topic, payload, _ = self.messages.recv_multipart()
            yield topic.decode(), msgpack.unpackb(payload)

    def end(self):
        self.loop.stop()
        self.thread.join(5.0)
        self.answering = False
        assert not self.thread.is_alive()


@pytest.fixture
def wires(tmp_path):
    wires = Wires(tmp_path)
    for name in wires.ports:
        wires.plug(name)
    far = threading.Thread(target=wires.answer)
    far.start()
    wires.thread.start()
    yield wires
    wires.end()
    far.join()
    for name in list(wires.masters):
        wires.unplug(name)
    for port in wires.ports.values():
        port.close()
    wires.aside.shutdown()
    wires.messages.close()
    wires.client.close()
    wires.context.destroy(linger=0)
    wires.bus.close()


def test_the_daemon_goes_from_idle_to_ready_and_to_its_end(wires):
    wires.wait_for("ready")
    time.sleep(1.1)
    wires.end()
    assert wires.rest is True
    table = {topic.name: topic for topic in TOPICS}
    counts = dict.fromkeys(table, 0)
    for topic, fields in wires.heard():
        assert validate(table[topic], fields) == []
        counts[topic] += 1
    ticks = wires.loop.statistics.ticks
    assert ticks + wires.loop.statistics.overruns > 80
    assert counts["palm/estimate"] == counts["palm/motion"] >= ticks - 5  # a subscriber joins late
    assert counts["palm/loop"] == counts["palm/info"] >= 1
    assert counts["palm/shape"] == 0


def test_a_port_that_vanishes_and_returns(wires):
    wires.wait_for("ready")
    wires.unplug("pad1")
    wires.wait_for("idle")
    assert "pad1-port" in wires.call("status")["result"]["faults"]
    wires.plug("pad1")
    wires.wait_for("ready")


def raises(*_):
    raise ZeroDivisionError("a defect")


@pytest.mark.parametrize("part", ["observer.shape", "core.counters", "core.report"])
def test_a_tick_that_raises_is_reported_once_and_messages_continue(wires, caplog, monkeypatch, part):
    wires.wait_for("ready")
    owner, name = part.split(".")
    with monkeypatch.context() as patch:
        patch.setattr(getattr(wires, owner), name, raises)
        wait(lambda: "tick-error" in wires.call("status")["result"]["faults"], "the error's fault")
        faults = wires.call("status")["result"]["faults"]
        assert set(faults) - {"loop-overrun", "loop-overruns"} == {"tick-error"}  # a slow machine misses deadlines too
        assert "arm refused" in wires.call("arm")["error"]
    (error,) = [record for record in caplog.records if record.levelname == "ERROR"]
    assert error.exc_info is not None
    wait(lambda: wires.call("reset")["ok"], "a reset that is granted")
    wires.wait_for("ready")


def _write(master, data):
    """Writes everything as fast as the loop reads it: a terminal holds 4 kB, and a slow machine leaves it full."""
    while data:
        with suppress(BlockingIOError):
            data = data[os.write(master, data) :]
        time.sleep(1e-3)


def test_random_bytes_on_every_port_have_no_effect(wires):
    wires.wait_for("ready")
    for master in list(wires.masters.values()):
        _write(master, os.urandom(2000))
    time.sleep(0.2)
    assert wires.call("status")["ok"]
    assert wires.core.counters()["pad1_bytes_discarded"] > 100
